"""The agents, the mathematics that they use, and the loop and driver that run them.

Here belongs what a controller decides in a cycle, and what carries it there. It imports only
`bus_schemas`. Begin with `agent.py` (what an agent is), then `direct.py` and `parent.py`.
"""
