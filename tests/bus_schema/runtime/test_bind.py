import ctypes

import numpy as np
import pytest

from bus_schema.runtime.compiled import bind, c_function, compiled, copying

c_hypot = c_function(ctypes.CDLL("libm.so.6"), "hypot", "float64", "float64", "float64")


@compiled
def _weighted(values, weights, out, factor):
    total = 0.0
    for i in range(values.size):
        out[i] = factor * weights[i] * values[i]
        total += out[i]
    return total


@compiled
def _length(values):
    return c_hypot(values[0], values[1])


def test_bound_function_does_what_the_function_does_and_sees_what_becomes_of_its_arrays():
    values, weights, out = np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.zeros(2)
    bound = bind(_weighted, values, weights, out, free=["float64"])
    assert bound(2.0) == _weighted(values, weights, np.zeros(2), 2.0) == 22.0
    values[:] = [5.0, 6.0]
    assert bound(1.0) == 39.0
    assert out.tolist() == [15.0, 24.0]


def test_arrays_of_any_layout_can_be_bound():
    rows = np.arange(8.0).reshape(2, 4)
    assert bind(_length, rows[:, 3])() == _length(np.array([3.0, 7.0]))


def test_bound_function_takes_no_other_number_of_arguments():
    bound = bind(_weighted, *np.ones((3, 2)), free=["float64"])
    with pytest.raises(TypeError):
        bound()


def test_compiled_code_calls_c():
    assert _length(np.array([3.0, 4.0])) == 5.0


def test_function_that_a_library_has_not_is_named():
    with pytest.raises(AttributeError, match="no_such_function"):
        c_function(ctypes.CDLL("libm.so.6"), "no_such_function", "intc")


@pytest.mark.parametrize("shape", [(3,), (2, 3)])
def test_copy_goes_to_the_same_place_each_time_and_only_there(shape):
    # As in a message, where rows do not follow one another at once.
    memory = np.full((*shape[:-1], 5), 9.0)
    source, target = np.zeros(shape), memory[..., :3]
    copy = copying(source, target)
    for value in (1.0, np.nan, -0.0):
        source[:] = value
        copy()
        assert target.tobytes() == source.tobytes()
    assert (memory[..., 3:] == 9.0).all()
