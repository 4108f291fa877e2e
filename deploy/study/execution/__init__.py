"""Carrying out a study: its folder, its workers, and what its rows were made with."""
