"""How setuptools installs a clone of this project (``pip install --editable``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from setuptools.command.editable_wheel import _StaticPth, editable_wheel

_ROOT = Path(__file__).resolve().parents[3]


class TypedEditableWheel(editable_wheel):
    """Puts both source folders on Python's path, where mypy and editors find types.

    By default setuptools installs a hook for imports, which only Python itself can follow.
    """

    def _select_strategy(self, name: str, *_: Any) -> _StaticPth:
        return _StaticPth(self.distribution, name, [_ROOT, _ROOT / "deploy" / "api"])
