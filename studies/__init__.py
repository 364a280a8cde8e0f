"""What control is worth: figures of merit, comparisons, timing, and their pages."""
