"""Timing measured on runs that it launches: one rate, or a sweep over rates."""
