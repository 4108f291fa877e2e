"""Messages on the bus: topics, message types, and their bytes."""
