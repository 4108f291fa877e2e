"""UFACTORY's private protocol over TCP: commands like Modbus, and reports."""
