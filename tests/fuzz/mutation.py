"""Mutations of bytes and of scenario values, all from one seeded generator."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

_BOUNDARIES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1)
_NASTY = (
    None, True, -1, 0, 1, 1e308, -1e308, 1e-308, 10**30, float("nan"), float("inf"), "", "x", "1e3",
    "\u202e", [], [[]], [1, 2], [None], {}, {"a": {}}, {"kind": "sine"}, "../..", "all", "null",
)  # fmt: skip


class Mutator:
    """Mutates what it is given, one to four times over."""

    def __init__(self, seed: int | list[int]) -> None:
        self._random = np.random.default_rng(seed)
        self._ways: Sequence[Callable[[bytearray], None]] = (
            self._flip, self._replace, self._cut, self._extend, self._repeat, self._put_boundary,
        )  # fmt: skip

    def chance(self, share: float) -> bool:
        return bool(self._random.random() < share)

    def choose(self, options: Sequence[Any]) -> Any:
        return options[int(self._random.integers(len(options)))]

    def bytes(self, data: bytes) -> bytes:
        mutated = bytearray(data)
        for _ in range(int(self._random.integers(1, 5))):
            self._ways[int(self._random.integers(len(self._ways)))](mutated)
        return bytes(mutated)

    def text(self, text: str) -> str:
        return self.bytes(text.encode()).decode("utf-8", errors="replace")

    def values(self, values: dict[str, Any]) -> dict[str, Any]:
        """A scenario with some values replaced, removed, or under another key."""
        mutated = copy.deepcopy(values)
        for _ in range(int(self._random.integers(1, 4))):
            self._change(mutated)
        return mutated

    def _change(self, node: Any) -> None:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return
        key = self.choose(keys)
        if isinstance(node[key], dict | list) and node[key] and self.chance(0.8):
            self._change(node[key])
        elif self.chance(0.15):
            del node[key]
        elif isinstance(node, dict) and self.chance(0.1):
            node[str(key) + self.choose(("x", ".", ""))] = node[key]
        elif isinstance(node[key], int | float) and self.chance(0.5):
            node[key] = node[key] * self.choose((-1, 0.5, 1.01, 1000)) + self.choose((0, 1e-9, 3))
        else:
            node[key] = copy.deepcopy(self.choose(_NASTY))

    def _place(self, data: bytearray) -> int:
        return int(self._random.integers(max(len(data), 1)))

    def _flip(self, data: bytearray) -> None:
        if data:
            data[self._place(data)] ^= 1 << int(self._random.integers(8))

    def _replace(self, data: bytearray) -> None:
        start = self._place(data)
        length = int(self._random.integers(1, 9))
        data[start : start + length] = self._random.bytes(length)

    def _cut(self, data: bytearray) -> None:
        del data[self._place(data) :]

    def _extend(self, data: bytearray) -> None:
        data += self._random.bytes(int(self._random.integers(1, 64)))

    def _repeat(self, data: bytearray) -> None:
        start = self._place(data)
        data += data[start : start + 64]

    def _put_boundary(self, data: bytearray) -> None:
        """A length or a number at the edge of its range, where one may stand."""
        start = self._place(data) // 4 * 4
        value = self.choose(_BOUNDARIES)
        data[start : start + 4] = int(value).to_bytes(4, "little")
