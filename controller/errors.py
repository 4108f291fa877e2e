"""The root of what goes wrong in a running controller."""

from __future__ import annotations


class ControllerError(Exception):
    """Root of the errors of a running controller."""
