"""What a cycle over CAN costs, beside a compiled one."""
