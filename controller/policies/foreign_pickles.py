"""Pickles of LeRobot's messages, written and read without LeRobot, PyTorch, or any code in them.

LeRobot's service carries pickles. Loading one can run any code that its sender chose. This reader
knows the few names of a chunk of actions and builds arrays from them; any other name is an error.
It takes no more memory than a few times the size of the pickle, because a pickle may repeat only
strings and names, and a tensor is no larger than its storage.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

import numpy as np

_STORAGES = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2"}
_MOST_OPCODES = 500_000
_MOST_LETTERS = 200
_STRINGS = frozenset({"BINUNICODE", "SHORT_BINUNICODE", "GLOBAL", "STACK_GLOBAL"})
"""Opcodes whose results a pickle may repeat. Lists in lists, repeated, grow without limit."""
_PUTS = frozenset({"BINPUT", "LONG_BINPUT"})
_OPCODES = _STRINGS | _PUTS | {
    "PROTO", "FRAME", "STOP", "MARK", "MEMOIZE", "BINGET", "LONG_BINGET",
    "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT",
    "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3",
    "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT", "SETITEM", "SETITEMS",
    "NEWOBJ", "REDUCE", "BUILD", "BINPERSID",
}  # fmt: skip
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

    __slots__ = ("action", "timestep")

    timestep: int
    action: np.ndarray[Any, Any]

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the attributes that a pickle has.

        Raises:
            pickle.UnpicklingError: they are no number and no array of one axis.
        """
        timestep, action = state["timestep"], state["action"]
        if type(timestep) is not int:
            raise pickle.UnpicklingError("has a timestep that is no integer")
        if not isinstance(action, np.ndarray) or action.ndim != 1:
            raise pickle.UnpicklingError("has an action that is no tensor of one axis")
        self.timestep, self.action = timestep, action


def timed_actions(data: bytes) -> list[TimedAction]:
    """Return the actions in a pickle.

    Raises:
        pickle.UnpicklingError: it is no list of actions, or needs another name.
    """
    scan = _Scan()
    names: dict[tuple[str, str], Any] = {
        (_HELPERS, "TimedAction"): TimedAction,
        ("torch._utils", "_rebuild_tensor_v2"): _Function(_tensor),
        ("torch.storage", "_load_from_bytes"): _Function(partial(_storage, scan)),
        ("collections", "OrderedDict"): _Function(_no_hooks),
    }
    try:
        found = _Reader(io.BytesIO(data), names, scan).load()
    except pickle.UnpicklingError:
        raise
    except Exception as error:  # damaged pickles raise almost anything
        reason = f"damaged: {type(error).__name__}: {error}"[:_MOST_LETTERS]
        raise pickle.UnpicklingError(reason) from error
    if not isinstance(found, list) or not found:
        raise pickle.UnpicklingError(f"is {type(found).__name__}, not a list of actions")
    for each in found:
        if not isinstance(each, TimedAction) or not hasattr(each, "action"):
            raise pickle.UnpicklingError("has an entry that is no TimedAction")
    return found


class _Scan:
    """Checks the opcodes of the pickles of one answer before any of them is read."""

    def __init__(self) -> None:
        self._left = _MOST_OPCODES

    def check(self, file: io.BytesIO) -> None:
        """Check the pickle at a position of a file, and go back there.

        Raises:
            pickle.UnpicklingError: it has too many opcodes, or one that no chunk of actions needs.
        """
        begin, left, before, repeatable = file.tell(), self._left, "", dict[int, bool]()
        for opcode, argument, _ in pickletools.genops(file):
            self._left -= 1
            name, index = opcode.name, cast(int, argument)
            if self._left < 0:
                raise pickle.UnpicklingError(f"has more than {_MOST_OPCODES} opcodes")
            if name not in _OPCODES:
                raise pickle.UnpicklingError(f"has the opcode {name}, which is not allowed")
            if name == "MEMOIZE":
                repeatable[len(repeatable)] = before in _STRINGS
            elif name in _PUTS:
                if index > left - self._left:  # a real one counts from zero
                    raise pickle.UnpicklingError(f"has the memo index {index}")
                repeatable[index] = before in _STRINGS
            elif name in ("BINGET", "LONG_BINGET") and not repeatable.get(index):
                raise pickle.UnpicklingError("repeats an object that is neither string nor name")
            before = before if name == "FRAME" else name  # large strings end a frame
        file.seek(begin)


class _Reader(pickle.Unpickler):
    """An unpickler that knows only these names."""

    def __init__(self, file: io.BytesIO, names: Mapping[tuple[str, str], Any], scan: _Scan) -> None:
        scan.check(file)
        super().__init__(file)
        self._names = names

    def find_class(self, module: str, name: str, /) -> Any:
        if (module, name) not in self._names:
            needed = f"{module}.{name}"[:_MOST_LETTERS]
            raise pickle.UnpicklingError(f"needs {needed}, which is not allowed")
        return self._names[module, name]


class _Sealed:
    """An object whose attributes no pickle can set."""

    __slots__ = ()

    def __setstate__(self, _: object) -> None:
        raise pickle.UnpicklingError("sets attributes of an object that is no action")


class _Function(_Sealed):
    """A function that a pickle may call."""

    __slots__ = ("_function",)

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *args: Any) -> Any:
        return self._function(*args)


class _Storage(_Sealed):
    """The values of a tensor, shape (values,)."""

    __slots__ = ("values",)

    def __init__(self, values: np.ndarray[Any, Any]) -> None:
        self.values = values


class _StorageReader(_Reader):
    """Reads the description of a storage in PyTorch's old format of files.

    Attributes:
        described: type and number of values, once it has been read.
    """

    described: tuple[str, int] | None = None

    def persistent_load(self, pid: Any, /) -> None:
        kind, dtype, _key, _device, size, *_ = pid
        if kind != "storage" or dtype not in _STORAGES.values() or not _are_counts(size):
            raise pickle.UnpicklingError("has no storage of numbers")
        self.described = dtype, size


def _storage(scan: _Scan, data: bytes) -> _Storage:
    """Return a storage: torch.save without a zip file.

    It has five pickles (magic number, version, machine, storage, keys), the number of values, and
    the values.
    """
    file, described = io.BytesIO(data), None
    for _ in range(5):
        reader = _StorageReader(file, _STORAGE_NAMES, scan)
        reader.load()
        described = reader.described or described
    if described is None or int.from_bytes(file.read(8), "little") != described[1]:
        raise pickle.UnpicklingError("has a storage of another size")
    dtype, size = described
    return _Storage(np.frombuffer(file.read(), dtype, size))


def _tensor(
    storage: object, offset: object, size: object, stride: object, *_: object
) -> np.ndarray[Any, Any]:
    """Return a copy of a view of a storage."""
    if not isinstance(storage, _Storage):
        raise pickle.UnpicklingError("has a tensor without a storage")
    if not (isinstance(size, tuple) and isinstance(stride, tuple) and len(size) == len(stride)):
        raise pickle.UnpicklingError("has a tensor without sizes and strides")
    if not _are_counts(offset, *size, *stride):
        raise pickle.UnpicklingError("has a tensor whose offset, sizes or strides are no counts")
    values = storage.values
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if 0 in size or last >= values.size or math.prod(size) > values.size:
        raise pickle.UnpicklingError("has a tensor outside its storage")
    steps = tuple(step * values.itemsize for step in stride)
    return np.lib.stride_tricks.as_strided(values[offset:], size, steps).copy()


def _are_counts(*values: object) -> bool:
    return all(type(value) is int and value >= 0 for value in values)


def _no_hooks() -> dict[str, object]:
    """Return the hooks of a tensor, of which it has none."""
    return {}


_STORAGE_NAMES = {("torch", name): dtype for name, dtype in _STORAGES.items()}
