"""Clients of Damiao motors, as their wheels have them.

LeRobot installs PyTorch and 60 packages more, and damiao-motor a web server, of which their motors'
modules use none. So the wheels alone are fetched, once, and the packages that LeRobot's modules
import without a use here are empty.
"""

from __future__ import annotations

import contextlib
import importlib.util
import subprocess
import sys
import tempfile
import zipfile
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest

LEROBOT = (
    {"huggingface-hub": "1.6.0", "lerobot": "0.6.1"}
    if sys.version_info >= (3, 12)
    else {"lerobot": "0.4.4"}
)
DAMIAO_MOTOR = "1.0.6"
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


def fetch_lerobot(folder: Path) -> None:
    """Make `lerobot` importable, see `fetch_wheel`."""
    for name, version in LEROBOT.items():
        fetch_wheel(name, version, folder)
    sys.meta_path.append(_EmptyPackages())  # after those that find what is installed


def fetch_wheel(name: str, version: str, folder: Path) -> None:
    """Make a package importable without its dependencies; skip the test where it cannot be.

    Args:
        name: of the package in the registry.
        version: which one.
        folder: where its wheel stays.
    """
    module, package = name.replace("-", "_"), folder / f"{name}-{version}"
    if importlib.util.find_spec(module) is not None:  # it is installed already
        return
    if not package.exists():
        words = ["pip", "download", "--no-deps", "--only-binary=:all:", f"{name}=={version}"]
        with tempfile.TemporaryDirectory(dir=folder) as own:  # others may fetch it, too
            fetched = subprocess.run(
                [sys.executable, "-m", *words, "--dest", own],
                capture_output=True, text=True, check=False, timeout=300,
            )  # fmt: skip
            if fetched.returncode:
                pytest.skip(f"{name} {version} cannot be fetched: {fetched.stderr.strip()[-300:]}")
            (wheel,) = Path(own).glob("*.whl")
            zipfile.ZipFile(wheel).extractall(Path(own) / "package")
            with contextlib.suppress(OSError):  # another one was faster
                (Path(own) / "package").rename(package)
    sys.path.append(str(package))
