"""The errors that a command reports in one line."""


class InputError(ValueError):
    """Bad input from a user: where, what was expected and what was found. Exit status 2."""


class FailureError(Exception):
    """What was asked for could not be done, for no fault of the input: exit status 1."""
