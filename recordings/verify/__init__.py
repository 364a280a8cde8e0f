"""Verification: agents run again on the inputs of a recording, their messages compared with it."""
