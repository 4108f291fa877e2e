"""What `bench` measures: the cost of each thing beside that of a bare one."""
