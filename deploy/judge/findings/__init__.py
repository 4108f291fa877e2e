"""Findings in a judged run beside its bounds: chattering, growth, stalls, delays, a loss."""
