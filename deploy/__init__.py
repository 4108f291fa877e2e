"""Brings controller and plant up, watches them, experiments with them and judges them."""
