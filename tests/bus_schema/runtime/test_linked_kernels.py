"""Kernels that others call become part of their callers; Python can call each of them."""

from __future__ import annotations

import gc
import importlib.util
import math
import os
import shutil
import subprocess
import sys
import traceback
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from tests.warm_process import ROOT

KERNELS = """
from bus_schema.runtime.compiled import compiled

@compiled
def root(value):
    if value < -9:
        raise ValueError("no root of", value)
    if value < 0:
        raise ValueError("no root")
    return value**0.5

@compiled
def twice(value):
    return 2.0 * root(value)

@compiled
def sum_of_roots(value):
    return root(value) + twice(value)
"""
ARRAYS = """
import numpy as np
from typing import Any, NamedTuple
from bus_schema.runtime.compiled import compiled, scratch

class Pair(NamedTuple):
    matrix: Any
    vector: Any

@compiled
def row_of(pair, row):
    return pair.matrix[row]

@compiled
def times(pair, factor):
    made = np.zeros(pair.vector.size)
    for k in range(made.size):
        made[k] = factor * pair.vector[k]
    return made

@compiled
def total(pair, row):
    sums, products = scratch(2), scratch((2, pair.vector.size))
    sums[:] = 0.0
    row, doubled = row_of(pair, row), times(pair, 2.0)
    for k in range(row.size):
        products[0, k], products[1, k] = row[k] * doubled[k], row[k]
    for k in range(row.size):
        sums[0] += products[0, k]
        sums[1] += products[1, k]
    return sums[0] + sums[1]
"""
RUN = """
import numpy as np
from bus_schema.runtime import compiled
assert compiled.all_finite(np.zeros(2))
print(sum(compiled.all_finite.stats.cache_misses.values()), compiled.__file__)
"""


@pytest.fixture
def kernels(tmp_path):
    file = tmp_path / "kernels.py"

    def load(text=KERNELS):
        file.write_text(text)
        spec = importlib.util.spec_from_file_location(file.stem, file)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


def test_only_the_outermost_kernel_becomes_machine_code(kernels):
    module = kernels()
    assert module.sum_of_roots(4.0) == 6.0
    folder = Path(module.sum_of_roots.stats.cache_path)
    assert {file.name.partition("-")[0] for file in folder.glob("*.nbi")} == {
        "kernels.sum_of_roots"
    }
    assert module.root.signatures == module.twice.signatures == []
    assert (module.twice(9.0), module.root(9.0)) == (6.0, 3.0)


def test_exceptions_of_inner_kernels_reach_python_with_their_arguments(kernels):
    for module in (kernels(), kernels()):  # compiled, and loaded
        assert math.isnan(module.sum_of_roots(math.nan))
        with pytest.raises(ValueError, match=r"^no root$"):
            module.sum_of_roots(-4.0)
        with pytest.raises(ValueError, match="no root of") as raised:
            module.sum_of_roots(-16.0)
        assert raised.value.args == ("no root of", -16.0)


def test_arrays_live_as_long_as_they_are_used_and_no_longer(kernels):
    module = kernels(ARRAYS)
    pair = module.Pair(np.arange(6.0).reshape(2, 3), np.ones(3))
    module.total(pair, 1)
    references = sys.getrefcount(pair.matrix), sys.getrefcount(pair.vector)
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    assert [module.total(pair, row) for row in (0, 1, 0)] == [9.0, 36.0, 9.0]
    assert module.row_of(pair, 1).tolist() == [3.0, 4.0, 5.0]
    after = rtsys.get_allocation_stats()
    _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free > 0
    assert references == (sys.getrefcount(pair.matrix), sys.getrefcount(pair.vector))


def test_functions_of_numba_call_kernels_that_another_kernel_compiled(kernels):
    module, numbers = kernels(ARRAYS), kernels()
    pair = module.Pair(np.arange(6.0).reshape(2, 3), np.ones(3))
    assert module.total(pair, 1) == 36.0
    assert numbers.sum_of_roots(4.0) == 6.0
    times, twice = module.times, numbers.twice
    assert numba.njit(lambda pair: times(pair, 3.0)[2])(pair) == 3.0
    assert numba.njit(lambda value: twice(value))(9.0) == 6.0


def test_python_calls_functions_of_numba_that_a_kernel_called(kernels):
    module = kernels()
    half = numba.njit(lambda value: 0.5 * value)
    assert module.compiled(lambda value: half(value) ** 2)(6.0) == 9.0
    assert half(6.0) == 3.0


def test_another_copy_of_the_sources_uses_the_same_machine_code(tmp_path):
    shutil.copytree(ROOT / "bus_schema", tmp_path / "copy" / "bus_schema")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    found = []
    for folder in (ROOT, tmp_path / "copy"):
        words = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r})\n{RUN}"]
        done = subprocess.run(
            words, capture_output=True, text=True, check=True, cwd=folder, env=environment
        )
        found.append(done.stdout.split())
    assert [misses for misses, _ in found] == ["1", "0"]
    assert found[1][1].startswith(str(tmp_path))


def test_kernels_work_without_what_numba_keeps_to_itself(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS)
    words = f"""
import sys
sys.path[:0] = [{str(ROOT)!r}, {str(tmp_path)!r}]
import numba.core.codegen
del numba.core.codegen.JITCodeLibrary
from kernels import root, sum_of_roots
print(sum_of_roots(4.0), len(root.signatures))
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    done = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.split() == ["6.0", "1"]


@pytest.mark.parametrize("is_on", [True, False])
def test_no_garbage_is_collected_while_a_kernel_compiles(kernels, is_on):
    module, was_on, collections = kernels(), gc.isenabled(), []
    compiler = numba.core.compiler.CompilerBase.compile_extra.__code__

    def note(phase, _):
        callers = (frame.f_code for frame, _ in traceback.walk_stack(sys._getframe()))
        collections.append(phase == "start" and compiler in callers)

    (gc.enable if is_on else gc.disable)()
    gc.callbacks.append(note)
    try:
        module.sum_of_roots.compile("(float64,)")
        assert gc.isenabled() == is_on
        with pytest.raises(numba.TypingError):
            module.sum_of_roots.compile("(unicode_type,)")
        assert gc.isenabled() == is_on
    finally:
        gc.callbacks.remove(note)
        (gc.enable if was_on else gc.disable)()
    assert not any(collections)
