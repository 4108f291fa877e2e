import ast
import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import bus_schema
from bus_schema.runtime.compiled import HAS_SAID

ROOT = Path(bus_schema.__file__).parent.parent
ROOMS = ("bus_schema", "controller", "plant_emulator")


def sources_with_kernels() -> dict[str, ast.Module]:
    sources = [file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))]
    return {
        ".".join(file.relative_to(ROOT).with_suffix("").parts): ast.parse(file.read_text())
        for file in sources
        if "\n@compiled" in file.read_text()
    }


def imported(module: ast.Module) -> dict[str, str]:
    """Where each name comes from that a module imports from us."""
    return {
        alias.asname or alias.name: node.module
        for node in module.body
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in ROOMS
        for alias in node.names
    }


def names_in_kernels(module: ast.Module) -> Iterator[str]:
    for node in module.body:
        if isinstance(node, ast.FunctionDef) and any(
            isinstance(each, ast.Name) and each.id == "compiled" for each in node.decorator_list
        ):
            for statement in node.body:
                for name in ast.walk(statement):
                    if isinstance(name, ast.Name):
                        yield name.id


def test_the_cache_is_named_by_all_that_kernels_are_made_of() -> None:
    # A constant from a file without kernels would stay what it was when a kernel was compiled.
    modules = sources_with_kernels()
    assert len(modules) > 10
    foreign = [
        f"{name} in {here}, from {imported(module)[name]}"
        for here, module in modules.items()
        for name in names_in_kernels(module)
        if name in imported(module) and imported(module)[name] not in modules
    ]
    assert foreign == []


RUN = """
import sys
from numba.core import event
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

with event.install_recorder("numba:compile") as compiling:
    data = simulate(load_setup("paper_arm", ["duration_s=0.05", "metrics.from_s=0"])).data()
print(len(compiling.buffer), "numba.typed.typeddict" in sys.modules, data.digest)
"""
TAKEN_AWAY = {
    "cache and entry point": """
import sys
from bus_schema.runtime import kernel_cache
kernel_cache.choose_folder()  # before numba looks
import numba.core.caching, numba.experimental.function_type
from numba.core.compiler import CompileResult
del numba.core.caching.FunctionCache
field = CompileResult.entry_point
class NumbasAlone:
    def __get__(self, result, owner):
        if sys._getframe(1).f_globals["__name__"].startswith("bus_schema"):
            raise AttributeError("entry_point")
        return field.__get__(result, owner)
CompileResult.entry_point = NumbasAlone()
""",
    "cache of a kernel": """
import sys
from bus_schema.runtime import kernel_cache
kernel_cache.choose_folder()  # before numba looks
from numba.core.dispatcher import Dispatcher
class NumbasAlone:
    def __get__(self, dispatcher, owner):
        if sys._getframe(1).f_globals["__name__"].startswith("bus_schema"):
            raise AttributeError("_cache")
        return vars(dispatcher)["cache"]
    def __set__(self, dispatcher, cache):
        assert not sys._getframe(1).f_globals["__name__"].startswith("bus_schema")
        vars(dispatcher)["cache"] = cache
Dispatcher._cache = NumbasAlone()
""",
    "loading": """
from numba.core.caching import Cache
Cache._load = Cache._load_overload
Cache.load_overload = lambda self, *arguments: self._load(*arguments)
del Cache._load_overload
""",
}


def ran(preamble: str = "") -> list[str]:
    """How often a run compiled, whether the compiler was loaded, and the digest."""
    words = [sys.executable, "-c", preamble + RUN]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT)
    return done.stdout.split()


def test_a_second_run_compiles_nothing_and_needs_nothing_that_numba_keeps_to_itself() -> None:
    first = ran()
    assert ran() == ["0", "False", first[2]]
    for taken, preamble in TAKEN_AWAY.items():
        assert ran(preamble)[2] == first[2], taken


KERNELS = """
from bus_schema.runtime.compiled import compiled

@compiled
def double(value):
    return 2 * value

@compiled
def triple(value):
    return 3 * value
"""


def fresh(file: Path) -> ModuleType:
    """The module in a file, loaded again."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_compilation_is_reported_once_and_only_when_it_happens(tmp_path, monkeypatch, caplog):
    file = tmp_path / "kernels.py"
    file.write_text(KERNELS)
    monkeypatch.delenv(HAS_SAID)
    module = fresh(file)
    assert caplog.messages == []
    assert (module.double(2), module.triple(2)) == (4, 6)
    assert len(caplog.messages) == 1
    assert caplog.messages[0].startswith("compiling the numerical kernels")
    caplog.clear()
    monkeypatch.delenv(HAS_SAID)
    again = fresh(file)
    assert (again.double(2), again.triple(2)) == (4, 6)
    assert caplog.messages == []


@pytest.mark.parametrize("left", [0, 30, 0.5])
def test_a_cache_that_was_cut_off_is_compiled_again_and_mended(tmp_path, monkeypatch, left):
    """Bytes, or a share, that a killed process left of the index of a kernel."""
    file = tmp_path / "kernels.py"
    file.write_text(KERNELS)
    kernel = fresh(file).double
    assert kernel(2) == 4
    (index,) = Path(kernel.stats.cache_path).glob("kernels.double-*.nbi")
    whole = index.read_bytes()
    index.write_bytes(whole[: int(left * len(whole)) if isinstance(left, float) else left])
    assert fresh(file).double(2) == 4
    mended = fresh(file).double
    assert mended(2) == 4
    assert sum(mended.stats.cache_hits.values()) == 1
