"""How much of a quantity a law survives: quantities, and the search for the limit."""
