"""LeRobot's bus of Damiao motors, as its wheel has it.

LeRobot installs PyTorch and 60 packages more, none of which the bus uses. So its wheel alone is
fetched, once, and the packages that its modules import without a use here are empty.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import zipfile
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

VERSION = "0.6.1" if sys.version_info >= (3, 12) else "0.4.4"
_UNUSED = ("torch", "accelerate", "datasets", "draccus", "serial", "deepdiff")


class _EmptyModule(ModuleType):
    """A module of which everything can be imported."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.__path__: list[str] = []

    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


class _EmptyPackages:
    """Finds the packages that are not installed."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        return ModuleSpec(name, self) if name.split(".")[0] in _UNUSED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _EmptyModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        pass


def fetch_lerobot(folder: Path) -> str | None:
    """Make `lerobot` importable; why it cannot be, if it cannot.

    Args:
        folder: where its wheel stays.
    """
    if importlib.util.find_spec("lerobot") is not None:  # somebody has installed it
        return None
    package = folder / VERSION
    if not package.exists():
        words = ["pip", "download", "--no-deps", "--only-binary=:all:", f"lerobot=={VERSION}"]
        fetched = subprocess.run(
            [sys.executable, "-m", *words, "--dest", str(folder)],
            capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        if fetched.returncode:
            return f"lerobot {VERSION} cannot be fetched: {fetched.stderr.strip()[-300:]}"
        zipfile.ZipFile(next(folder.glob(f"lerobot-{VERSION}-*.whl"))).extractall(package)
    sys.path.append(str(package))
    sys.meta_path.append(_EmptyPackages())  # after those that find what is installed
    return None
