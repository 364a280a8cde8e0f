"""The world: irradiance, PV power, inverters, what the market wants, and the plant as an agent."""
