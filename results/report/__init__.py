"""The report of a run: one HTML page with its figures and tables, which opens without a network."""
