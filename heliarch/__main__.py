"""`python -m heliarch` is `heliarch`."""

from heliarch.cli.main import main

if __name__ == "__main__":
    main()
