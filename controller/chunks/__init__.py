"""Answers of laws that are slower than the loop, and how a new one follows an old one."""
