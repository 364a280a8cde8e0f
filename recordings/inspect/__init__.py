"""What happened in a recorded run."""
