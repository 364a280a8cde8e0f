"""What virtual neighbours are worth."""
