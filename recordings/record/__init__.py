"""Writes a run down."""
