"""Verification: agents re-run on the inputs of a recording, their words held against the old."""
