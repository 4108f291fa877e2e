"""Kernels count no references to parts of their arguments, and keep what they return."""

from __future__ import annotations

import gc
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import types
from numba.core.runtime.context import NRTContext

from bus_schema.runtime.compiled import compiled


class Inner(NamedTuple):
    values: np.ndarray
    factors: np.ndarray


class Outer(NamedTuple):
    inner: Inner
    others: np.ndarray
    number: int


def outer():
    return Outer(Inner(np.arange(4.0), np.arange(1.0, 5.0)), np.ones(4), 3)


def weighted(inner):
    total = 0.0
    for i in range(inner.values.size):
        total += inner.values[i] * inner.factors[i]
    return total


def chosen(given, first):
    inner, others, number = given
    part = inner.values if first and number > 0 else others
    for _ in range(number):
        inner.values[0] += 1.0
    return part, inner.factors, given


def replaced(values, other, times):
    for _ in range(times):
        values = other
    return values


def test_no_reference_to_a_part_of_an_argument_is_counted(monkeypatch):
    counted = []
    original = NRTContext.incref

    def note(context, builder, type_, value):
        if isinstance(type_, (types.Array, types.BaseTuple)):
            counted.append(type_)
        original(context, builder, type_, value)

    monkeypatch.setattr(NRTContext, "incref", note)
    inner = compiled(weighted)

    @compiled
    def entry(given):
        parts = given.inner
        return inner(parts) + given.number

    assert entry(outer()) == np.arange(4) @ np.arange(1, 5) + 3
    assert counted == []


@pytest.mark.parametrize("first", [True, False])
def test_returned_parts_live_as_long_as_they_are_used(first):
    given, kernel = outer(), compiled(chosen)
    arrays = [*given.inner, given.others]
    kernel(given, first)
    gc.collect()
    before = [sys.getrefcount(each) for each in arrays]
    for _ in range(10):
        part, factors, again = kernel(given, first)
        expected = given.inner.values if first else given.others
        assert part.tolist() == expected.tolist()
        assert factors.tolist() == [1.0, 2.0, 3.0, 4.0]
        assert again.inner.values[0] == given.inner.values[0]
        del part, factors, again, expected
    assert [sys.getrefcount(each) for each in arrays] == before


def test_an_argument_that_is_replaced_is_counted():
    kernel, values, other = compiled(replaced), np.zeros(2), np.ones(2)
    kernel(values, other, 1)
    before = sys.getrefcount(values), sys.getrefcount(other)
    for times in (0, 1, 2):
        assert kernel(values, other, times).tolist() == ([1.0, 1.0] if times else [0.0, 0.0])
    assert (sys.getrefcount(values), sys.getrefcount(other)) == before
