"""`python -m launch_scripts` is `heliarch`."""

from launch_scripts.cli import main

if __name__ == "__main__":
    main()
