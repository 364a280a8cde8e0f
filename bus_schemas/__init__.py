"""What travels on the bus: message types, the one table of signals, keys, codec, and the bus.

Here belongs what two processes must agree on. It imports nothing of Heliarch. Begin with
`signals.py`, the table of signals, then `messages.py` and `bus.py`.
"""
