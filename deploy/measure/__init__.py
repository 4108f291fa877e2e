"""Measurements of real networks and robots: delays, traces for the emulated link, plants."""
