"""The errors that a command reports in one line."""


class InputError(ValueError):
    """Bad input from a user: exit status 2.

    The message says which file, line or field, what was expected and what was found.
    """


class FailureError(Exception):
    """What was asked for could not be done, for no fault of the input: exit status 1."""
