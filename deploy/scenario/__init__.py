"""Scenario files: reading, checks, and completion."""
