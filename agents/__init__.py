"""The agents, the mathematics that they use, and the loop and driver that run them."""
