import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import bus_schema

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


SECOND = """
import sys
from numba.core import event
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup

with event.install_recorder("numba:compile") as compiling:
    data = simulate(load_setup("paper_arm", ["duration_s=0.05", "metrics.from_s=0"])).data()
print(len(compiling.buffer), "numba.typed.typeddict" in sys.modules, data.digest)
"""


def test_a_second_run_compiles_nothing_and_loads_no_compiler() -> None:
    first, second = (
        subprocess.run(
            [sys.executable, "-c", SECOND], capture_output=True, text=True, check=True, cwd=ROOT
        ).stdout.split()
        for _ in range(2)
    )
    assert second[:2] == ["0", "False"]
    assert second[2] == first[2]
