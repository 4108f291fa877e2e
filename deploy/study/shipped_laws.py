"""Laws of a user's own that go with a run to whoever does it, as their code."""

from __future__ import annotations

import sys
import sysconfig
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import cloudpickle

from controller.laws.custom import EXTERNAL, Maker, find_law, is_custom, laws_given
from deploy.runs.run_rows import Row
from deploy.study.study import Run, execute, failed

Packed = Mapping[str, bytes]
"""Laws by name, as `cloudpickle` has them."""


def packed(laws: Iterable[str]) -> Packed:
    """Those of the laws that are the user's own, packed.

    One that cannot be packed is left out: workers import it, where they have its file.
    """
    found = {name: _packed(find_law(name)) for name in laws if is_custom(name) and name != EXTERNAL}
    return {name: code for name, code in found.items() if code is not None}


def execute_with(run: Run, laws: Packed) -> Row:
    """`execute`, with laws that came along."""
    try:
        makers = {name: _unpacked(code) for name, code in laws.items()}
    except Exception as error:  # noqa: BLE001 - what a law imports may not be there
        return failed(run, f"{type(error).__name__}: {error}")
    with laws_given(makers):
        return execute(run)


def _packed(make: Maker) -> bytes | None:
    """A law with its whole module, unless that is a package that workers have as well."""
    module = sys.modules.get(make.__module__)
    by_value = module is not None and _is_of_the_user(module)
    if by_value:
        cloudpickle.register_pickle_by_value(module)
    try:
        code: bytes = cloudpickle.dumps(make)
        return code
    except Exception:  # noqa: BLE001 - an object may refuse to be pickled in any way
        return None
    finally:
        if by_value:
            cloudpickle.unregister_pickle_by_value(module)


def _is_of_the_user(module: ModuleType) -> bool:
    """Whether a module is a file of the user's own, and not installed."""
    file = getattr(module, "__file__", None)
    if module.__name__ == "__main__" or file is None:
        return False
    installed = (sysconfig.get_path("purelib"), sysconfig.get_path("platlib"))
    ours = Path(__file__).resolve().parents[2]
    folders = [*map(Path, installed), ours]
    return not any(Path(file).resolve().is_relative_to(folder) for folder in folders)


@lru_cache(maxsize=16)
def _unpacked(code: bytes) -> Maker:
    make: Maker = cloudpickle.loads(code)
    return make
