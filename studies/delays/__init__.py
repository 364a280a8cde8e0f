"""What delay and loss of messages cost."""
