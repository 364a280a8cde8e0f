"""Recorded messages back on the bus, with live controllers among them."""
