"""The closed loop over arrays: many runs in little time."""
