"""Sections of the result of a run: each figure has one declaration, beside its computation."""
