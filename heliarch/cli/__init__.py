"""The commands of `heliarch`, one file for each.

A command imports what does its work when it runs: `--help` does not wait for it.
"""
