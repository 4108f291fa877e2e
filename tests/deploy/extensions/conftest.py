"""Packages that pip would install: their code and a ``*.dist-info`` on the search path."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bus_schema.runtime import extensions

EXAMPLE = Path(__file__).with_name("package")


def install(project: dict, folder: Path) -> None:
    """Write the metadata of a package as pip does, from the table ``project`` of pyproject.toml."""
    name, version = project["name"], project["version"]
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture
def add_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Installs a package, from its ``project`` and the folder with its code, for one test."""
    before, site = set(sys.modules), tmp_path / "site-packages"
    monkeypatch.syspath_prepend(str(site))

    def add(project: dict, code: Path | None = None) -> None:
        install(project, site)
        if code is not None:
            monkeypatch.syspath_prepend(str(code))
        extensions.installed.cache_clear()

    yield add
    monkeypatch.undo()
    extensions.installed.cache_clear()
    for name in set(sys.modules) - before:
        if name.partition(".")[0] == "funnel_hil_example":
            del sys.modules[name]


@pytest.fixture
def example_package(add_package: Callable[..., None]) -> None:
    """The example package, installed."""
    add_package(tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"], EXAMPLE)
