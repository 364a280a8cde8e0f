"""Thousands of runs with random faults, and what must hold in every cycle of them."""
