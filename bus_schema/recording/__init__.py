"""Recordings, and files that are whole or not there."""
