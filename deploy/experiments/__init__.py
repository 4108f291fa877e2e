"""Simulation, metrics, replay and reports."""
