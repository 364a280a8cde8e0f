"""Who decides: the agents, the mathematics they use, and the runtime that runs any of them."""
