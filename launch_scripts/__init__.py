"""How it starts: the command line, scenarios, the launcher of processes, the run in memory."""
