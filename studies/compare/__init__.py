"""Control schemes side by side."""
