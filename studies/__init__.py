"""Studies of control: figures of merit, comparisons, timing, conformance, and their pages."""
