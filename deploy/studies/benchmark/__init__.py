"""Benchmarks: laws and predictors on the same runs."""
