"""Pickles of LeRobot's messages, written and read without LeRobot, PyTorch, or any code in them.

LeRobot's service carries pickles. Loading one can run any code that its sender chose. This reader
knows the few names of a chunk of actions and builds arrays from them; any other name is an error.
"""

from __future__ import annotations

import io
import pickle
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

_STORAGES = {
    "FloatStorage": np.dtype("<f4"), "DoubleStorage": np.dtype("<f8"),
    "HalfStorage": np.dtype("<f2"),
}  # fmt: skip
_MOST_VALUES = 10_000_000
_HELPERS = "lerobot.async_inference.helpers"


def pickled_instance(name: str, state: Mapping[str, object]) -> bytes:
    """Return the pickle of an instance of a class of LeRobot's helpers, with these attributes.

    Args:
        name: of the class.
        state: attributes, of types that Python or NumPy has.
    """
    body = pickle.dumps(dict(state), 2)[2:-1]  # without PROTO 2 and STOP
    new = pickle.PROTO + b"\x02" + pickle.GLOBAL + f"{_HELPERS}\n{name}\n".encode()
    return new + pickle.EMPTY_TUPLE + pickle.NEWOBJ + body + pickle.BUILD + pickle.STOP


class TimedAction:
    """One action of a chunk, as LeRobot's class of this name.

    Attributes:
        timestep: number of the observation that it answers, plus its row.
        action: its values, shape (joints,).
    """

    timestep: int
    action: Any


def timed_actions(data: bytes) -> list[TimedAction]:
    """Return the actions in a pickle.

    Raises:
        pickle.UnpicklingError: it is no list of actions, or needs another name.
    """
    try:
        found = _Reader(io.BytesIO(data), _NAMES).load()
    except pickle.UnpicklingError:
        raise
    except Exception as error:  # damaged pickles raise almost anything
        raise pickle.UnpicklingError(f"damaged: {type(error).__name__}: {error}") from error
    if not isinstance(found, list) or not found:
        raise pickle.UnpicklingError(f"is {type(found).__name__}, not a list of actions")
    for each in found:
        if not isinstance(each, TimedAction) or not {"timestep", "action"} <= vars(each).keys():
            raise pickle.UnpicklingError("has an entry that is no TimedAction")
    return found


class _Reader(pickle.Unpickler):
    """An unpickler that knows only these names."""

    def __init__(self, file: io.BytesIO, names: Mapping[tuple[str, str], Any]) -> None:
        super().__init__(file)
        self._names = names

    def find_class(self, module: str, name: str, /) -> Any:
        if (module, name) not in self._names:
            raise pickle.UnpicklingError(f"needs {module}.{name}, which is not allowed")
        return self._names[module, name]


class _StorageReader(_Reader):
    """Reads the description of a storage in PyTorch's old format of files."""

    def persistent_load(self, pid: Any, /) -> tuple[np.dtype[Any], int]:
        kind, dtype, _key, _device, size, *_ = pid
        if kind != "storage" or not isinstance(size, int) or not 0 <= size <= _MOST_VALUES:
            raise pickle.UnpicklingError(f"has no storage of at most {_MOST_VALUES} values")
        return dtype, size


def _storage(data: bytes) -> np.ndarray[Any, Any]:
    """Return the values of a storage: torch.save without a zip file.

    It has five pickles (magic number, version, machine, storage, keys), the number of values, and
    the values.
    """
    file, described = io.BytesIO(data), None
    for part in range(5):
        loaded = _StorageReader(file, _STORAGE_NAMES).load()
        described = loaded if part == 3 else described
    if described is None or int.from_bytes(file.read(8), "little") != described[1]:
        raise pickle.UnpicklingError("has a storage of another size")
    dtype, size = described
    return np.frombuffer(file.read(size * dtype.itemsize), dtype, size)


def _tensor(
    storage: np.ndarray[Any, Any], offset: int, size: tuple[int, ...], stride: tuple[int, ...],
    *_: object,
) -> np.ndarray[Any, Any]:  # fmt: skip
    """Return a copy of a view of a storage."""
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if min((offset, *size, *stride)) < 0 or 0 in size or last >= storage.size:
        raise pickle.UnpicklingError("has a tensor outside its storage")
    if int(np.prod(size, dtype=object)) > _MOST_VALUES:
        raise pickle.UnpicklingError(f"has a tensor of more than {_MOST_VALUES} values")
    steps = tuple(step * storage.itemsize for step in stride)
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps).copy()


_NAMES: dict[tuple[str, str], type | Callable[..., Any]] = {
    (_HELPERS, "TimedAction"): TimedAction,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch.storage", "_load_from_bytes"): _storage,
    ("collections", "OrderedDict"): OrderedDict,
}
_STORAGE_NAMES = {("torch", name): dtype for name, dtype in _STORAGES.items()}
