"""The one error that a user's input can cause."""


class InputError(ValueError):
    """Bad input from a user, told in one line.

    The message says which file, line or field, what was found there and what is accepted. The
    command line prints it as it is and ends with exit status 2.
    """
