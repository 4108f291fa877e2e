"""What is said on the bus: topics, message types, and their bytes."""
