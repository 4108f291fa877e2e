"""All that both sides of the bus must agree on, and what carries it."""
