"""Studies: many days and settings, all control schemes side by side, over arrays."""
