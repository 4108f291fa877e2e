"""Provenance of a row: versions, arithmetic, and every file that its run and its law have read.

A provenance has a value by part: a version, or the digest of a file. A row is valid as long as all
of its parts have the same values.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path

from bus_schema.registry import extensions_in
from bus_schema.runtime.extensions import Extension
from bus_schema.user_files import is_file
from controller.law_choice import is_program
from controller.laws.custom import find_law, is_custom, is_given, read_by_imports
from controller.laws.read_files import (
    ABSENT,
    OUR_FOLDER,
    OURS,
    digest_of_file,
    is_of_the_user,
)
from deploy.judge.arithmetic import libm_fingerprint
from deploy.run.confirmation import other_physics
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import leaves, plain
from deploy.study.execution.law_code import code_of
from plant_emulator.physics.engines import ENGINES, engine_name

Provenance = dict[str, str]

UNSEEN = "not seen"
"""Part of rows whose law may have read something that is not seen, with the reason."""
_LIBM = "C library"
_MODULE, _FOLDER = "module ", "current folder"
_OURS = "funnel-hil"
_COMPUTING = ("numpy", "numba", "pin")
_MAKING_ROWS = ("bus_schema", "controller", "plant_emulator", "deploy/judge", "deploy/run",
                "deploy/scenario")  # fmt: skip
_LONGEST = 255


def provenance_of(setup: Setup, confirm: bool, read: Mapping[str, str]) -> Provenance:
    """Return the provenance of a run, without the code of a custom law.

    Args:
        setup: its scenario.
        confirm: whether it was also simulated on other physics.
        read: the files that it has read, as in `files_read`.
    """
    setups = [setup, *(other_physics(setup).values() if confirm else ())]
    engines = [ENGINES[engine_name(each.scenario.plant)].distribution for each in setups]
    added = [each for one in setups for each in extensions_in(plain(one.scenario))]
    packages = [*engines, *(each.distribution for each in added)]
    files = {str(setup.robot.path.resolve()), *_named_files(setup), *_files_of(added)}
    parts = current([_OURS, _LIBM, *_COMPUTING, *packages, *files])
    return {**parts, **read}


def provenance_of_law(name: str) -> Provenance:
    """Return the code of a custom law: its modules, files that they name, versions of packages.

    Its modules are those of the user that it imports, directly or not, as loaded in this process.
    If it may also read something that is not seen, `UNSEEN` says so.
    """
    if is_program(name):
        return {UNSEEN: f"{name} is a program"}
    if not is_custom(name):
        return {}
    if is_given(name):
        return {UNSEEN: f"{name} was given as an object"}
    find_law(name)
    code = code_of(name.partition(":")[0])
    named = (
        each for file, texts in code.files.items() for each in _files_named(texts, file.parent)
    )
    parts = current([*map(str, code.files), *named, *_distributions(code.packages)])
    parts = {
        k: v for read in (parts, *read_by_imports) if parts.keys() & read for k, v in read.items()
    }
    parts |= {_MODULE + module: place for module, place in code.places.items()}
    parts[_FOLDER] = str(Path.cwd())
    if code.unseen:
        parts[UNSEEN] = f"{name} uses {', '.join(sorted(code.unseen))}"
    return parts


def law_files(made_by: Provenance) -> Provenance:
    """Return the parts of a provenance that are source files of a custom law."""
    modules = (value for part, value in made_by.items() if part.startswith(_MODULE))
    return {file: made_by[file] for file in modules if file in made_by}


def current(parts: Iterable[str]) -> Provenance:
    """Return the present values of parts of a provenance, in this process."""
    return {part: _value(part) for part in sorted(set(parts))}


def differences(old: Provenance, now: Mapping[str, str]) -> list[str]:
    """Name the parts of a provenance that have changed since, each with both values."""
    return [
        f"{part}: {value} before, {now.get(part, ABSENT)} now"
        for part, value in old.items()
        if now.get(part, ABSENT) != value
    ]


def _value(part: str) -> str:
    if part == _LIBM:
        return libm_fingerprint()
    if "/" in part:
        return digest_of_file(Path(part)) or ABSENT
    return _version(part) + (_own_source() if part == _OURS else "")


@cache  # it reads files
def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except (metadata.PackageNotFoundError, ValueError):
        return ABSENT


@cache
def _own_source() -> str:
    """Return a digest of our code that makes rows, in a checkout, whose version says too little."""
    if not is_of_the_user(f"{OUR_FOLDER}/"):
        return ""
    found = hashlib.sha256()
    for file in sorted(f for room in _MAKING_ROWS for f in Path(OUR_FOLDER, room).rglob("*.py")):
        found.update(file.read_bytes())
    return f" with source {found.hexdigest()[:8]}"


def _named_files(setup: Setup) -> Iterator[str]:
    """Return the files that a scenario names, such as traces, programs, arguments and gains."""
    words = [value for _, value in leaves(plain(setup.scenario))]
    texts = [text for word in words for text in (word if isinstance(word, list) else [word])]
    yield from _files_named((text for text in texts if isinstance(text, str)), Path.cwd())
    controller = setup.scenario.controller
    external = controller.external.command if controller.external is not None else ()
    for command in (controller.process, external):
        if command and (program := shutil.which(command[0])):
            yield str(Path(program).resolve())


def _files_of(extensions: Iterable[Extension]) -> Iterator[str]:
    """Return the loaded source files of packages, whose versions say too little after an edit."""
    for extension in extensions:
        package = extension.entry.module.partition(".")[0]
        for name, module in list(sys.modules.items()):
            if name.partition(".")[0] == package and (file := getattr(module, "__file__", None)):
                yield str(Path(file).resolve())


def _files_named(texts: Iterable[str], folder: Path) -> Iterator[str]:
    """Return the files in this or the current folder that texts name, also as ``--option=file``."""
    for text in texts:
        for name in {text, text.partition("=")[2]}:
            if "." in name and len(name) <= _LONGEST and name.isprintable():
                found = (place / name for place in (folder, Path.cwd()))
                yield from (str(path.absolute()) for path in found if is_file(path))


@cache  # it reads the list of files of every installed package: a second or two
def _packages_distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()


def _distributions(packages: Iterable[str]) -> set[str]:
    """Return the distributions of installed packages; not Python's own, nor ours."""
    found = set(packages) - sys.stdlib_module_names - set(OURS)
    unlike = {name for name in found if _version(name) == ABSENT}
    named = _packages_distributions() if unlike else {}
    return (found - unlike) | {each for name in unlike for each in named.get(name, ())}
