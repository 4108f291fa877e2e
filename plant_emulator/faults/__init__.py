"""Scheduled faults of the arm and of the link."""
