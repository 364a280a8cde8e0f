"""The commands of `heliarch`, one file for each."""
