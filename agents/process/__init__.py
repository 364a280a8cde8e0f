"""An agent as a process: its session on the bus, its link to the launcher, its machine."""
