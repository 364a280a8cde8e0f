"""What travels on the bus: message types, the one table of signals, keys, codec, and the bus."""
