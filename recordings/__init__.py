"""What is kept of a run: the recorder, the reader, and the figures that are drawn from it."""
