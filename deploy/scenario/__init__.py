"""Scenario files: read, checked, and completed."""
