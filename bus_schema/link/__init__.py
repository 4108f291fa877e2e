"""What a loop may ask of a bus, and the scenario's section about it."""
