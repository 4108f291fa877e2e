"""What a command ends with exit code 2 for; a module of its own, as every command needs it."""

from __future__ import annotations


class InputError(Exception):
    """What the user gave cannot be used; the message says what, and what is allowed."""
