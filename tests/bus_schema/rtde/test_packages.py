"""Bytes of RTDE, protocol 2, as Universal Robots' guide has them."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.rtde.packages import Kind, PackageReader, Recipe, package


def test_a_package_is_size_kind_and_payload():
    assert package(Kind.PROTOCOL_VERSION, b"\x00\x02") == bytes([0, 5, 86, 0, 2])
    assert package(Kind.START) == bytes([0, 3, 83])


@given(st.lists(st.integers(1, 30), max_size=40))
def test_packages_arrive_whole_however_their_bytes_are_cut(cuts):
    sent = [(85, bytes(range(20))), (83, b""), (79, b"actual_q,target_q")]
    stream = b"".join(package(Kind(kind), payload) for kind, payload in sent)
    reader, found, place = PackageReader(), [], 0
    for cut in [*cuts, len(stream)]:
        found += reader.take(stream[place : place + cut])
        place += cut
    assert found == sent[: len(found)]
    assert len(found) == len(sent)


def test_a_size_below_the_header_is_refused():
    with pytest.raises(ValueError, match="2 bytes: must have at least 3"):
        list(PackageReader().take(bytes([0, 2, 85])))


def test_a_recipe_packs_its_variables_in_order_and_big_endian():
    types = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "robot_mode": "INT32", "on": "BOOL"}
    values = {"timestamp": 1.5, "actual_q": [1, 2, 3, 4, 5, 6.5], "robot_mode": -1, "on": True}
    payload = Recipe(7, types).pack({**values, "other": 3})
    assert payload == struct.pack(">B7di?", 7, 1.5, 1, 2, 3, 4, 5, 6.5, -1, True)
    assert Recipe(7, types).unpack(payload) == values


def test_a_payload_of_another_size_or_an_unknown_type_is_refused():
    with pytest.raises(ValueError, match="8 bytes: must be 9"):
        Recipe(1, {"timestamp": "DOUBLE"}).unpack(bytes(8))
    with pytest.raises(ValueError, match="x: must be one of BOOL"):
        Recipe(1, {"x": "FLOAT"})
