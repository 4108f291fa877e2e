"""Pickles of LeRobot's messages, against ones that LeRobot 0.4.4 with PyTorch 2.14 wrote."""

from __future__ import annotations

import base64
import io
import os
import pickle
import zlib

import numpy as np
import pytest

from controller.policies.foreign_pickles import pickled_instance, timed_actions
from tests.controller.policies.servers import (
    ClassesOfTheServer,
    Named,
    action_pickle,
    pickled,
    tensor,
)

OF_LEROBOT = zlib.decompress(
    base64.b85decode(
        "c-rk!zi-n(7(K^sk|t>tF(5I~(Fn<E5v|&(4MOc;@vAU+sZNf4?H#(@`F^-kkRq8O5+H9J8v`SM27d}G13O3ze2G"
        "!TkO|g)@;l3)-#veR@2cR#_W&*H%!T!BPP80L8>MC{GR(v|(L`h<qJ$Sj8&~&VunEaWnPpPA_wLSXH-mla7P`i!l"
        "fs=G{%G{-Zqp=%i#v5YZMM_{D|JRATw2CK?*`UnTr!?xON5acU)}@Ru-<5B25#vEarF>$ndbOh%LyJ&Eiu4)aMwe"
        "qYQ5|6UmuTuZoT~c^j1{09)0s+ohcM1Ll~pb(#lM7d<pZz1j++KvH@>6vz8M~M9xy7T5pmbH0`t?*sxc`D1WAcFj"
        "<49p;BA57Pk@~o|v$z9S6z6H!j76>cl}=!Z*XDvmiGkE0isNp?3^}+viQQr@UknI0yF+wxRZScX#%7_Ee*r6{Ygy"
        "!DFj}XP|bb&?>H%Mg#PBRfn(~!3C%Qp8#I~Ujb-@&=9Z%*dDpLJ9RONgSm^nxqDmp!52=J!7QSEqH~Blf5<Ysi1y"
        "T3;Fn|SH!0Kh$<d#)LOXGnc4<GPo7W-yO9;VL2=wMkqX$<;uU{MeA4Ydq8BL<!PGDYL"
    )
)
"""pickle.dumps of three TimedAction(1.5 + i, 7 + i, row i of arange(12.0).reshape(3, 4))."""


def test_actions_of_lerobot_are_read():
    found = timed_actions(OF_LEROBOT)
    assert [each.timestep for each in found] == [7, 8, 9]
    np.testing.assert_array_equal([each.action for each in found], np.arange(12.0).reshape(3, 4))


def test_actions_as_the_test_server_writes_them_are_read():
    actions = np.array([[0.5, -1.25], [2.0, 3.0]])
    found = timed_actions(action_pickle(4, actions))
    assert [each.timestep for each in found] == [4, 5]
    np.testing.assert_array_equal([each.action for each in found], actions)


def test_what_the_client_sends_is_an_instance_with_its_attributes():
    image = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    data = pickled_instance("TimedObservation", {"timestep": 3, "observation": {"front": image}})
    found = ClassesOfTheServer(io.BytesIO(data)).load()
    assert type(found).__name__ == "TimedObservation"
    assert found.timestep == 3
    np.testing.assert_array_equal(found.observation["front"], image)


class Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/never",)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (pickle.dumps(Evil()), r"system, which is not allowed"),
        (pickle.dumps([np.arange(3.0)]), r"_reconstruct, which is not allowed"),
        (pickle.dumps([]), "not a list of actions"),
        (pickle.dumps({"a": 1}), "is dict, not a list of actions"),
        (pickle.dumps([1.0]), "no TimedAction"),
        (b"garbage", "truncated|invalid load key|damaged"),
        (b"", "damaged"),
        (OF_LEROBOT[:-40], "damaged|truncated"),
        (OF_LEROBOT.replace(b"K\x04\x85", b"K\x7f\x85"), "outside its storage"),
        (OF_LEROBOT.replace(b"K\x0cNtq", b"K\x7fNtq"), "another size"),
        (OF_LEROBOT.replace(b"FloatStorage", b"QuantStorage"), "QuantStorage, which is not"),
    ],
)
def test_other_pickles_are_refused(data, message):
    with pytest.raises(pickle.UnpicklingError, match=message):
        timed_actions(data)


def test_refused_pickle_runs_nothing(tmp_path):
    class Writes:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    with pytest.raises(pickle.UnpicklingError):
        timed_actions(pickle.dumps([Writes()]))
    assert not (tmp_path / "ran").exists()


HELPERS = "lerobot.async_inference.helpers"
REBUILD = "torch._utils", "_rebuild_tensor_v2"
LIST, STEP_OF_7 = pickle.EMPTY_LIST, b"}X\x08\x00\x00\x00timestepK\x07s"


def answer_of(timestep, action):
    """Opcodes of a list of one action, whose attributes are given as opcodes."""
    state = pickled("timestep") + timestep + pickled("action") + action
    new = f"c{HELPERS}\nTimedAction\n".encode() + b")\x81"
    return b"\x80\x04](" + new + b"}(" + state + b"ube."


def view(storage, offset, size, stride):
    return pickled(Named(*REBUILD, (storage, offset, size, stride)))


def storage_of(count):
    return tensor(np.arange(count)).arguments[0]


def repeated(opcodes):
    """A tuple of twice the same object."""
    return opcodes + b"q\x00h\x00\x86"


def test_answer_of_these_opcodes_is_read():
    found = timed_actions(answer_of(pickled(4), view(storage_of(4), 1, (2,), (2,))))
    np.testing.assert_array_equal(found[0].action, [1.0, 3.0])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            view(Named(*REBUILD, (storage_of(4), 0, (2, 2), (2, 1))), 1, (3,), (1,)),
            "without a storage",
        ),
        (view(b"12345678", 0, (2,), (1,)), "without a storage"),
        (view(storage_of(4), True, (2,), (1,)), "no counts"),
        (view(storage_of(4), 0, (2.0,), (1,)), "no counts"),
        (view(storage_of(4), 0, (2,), (True,)), "no counts"),
        (view(storage_of(4), 3, (2,), (-1,)), "no counts"),
        (view(storage_of(4), 0, (2,), (1, 1)), "without sizes and strides"),
        (view(storage_of(1), 0, (10_000_000,), (0,)), "outside its storage"),
        (view(storage_of(4), 0, (3, 3), (1, 1)), "outside its storage"),
        (view(storage_of(4), 0, (2, 2), (2, 1)), "no tensor of one axis"),
        (pickled(1.0), "no tensor of one axis"),
        (LIST, "no tensor of one axis"),
        (repeated(LIST), "repeats an object"),
        (repeated(b"))\x86"), "repeats an object"),
        (repeated(pickled(b"many bytes")), "repeats an object"),
        (b"K\x01r\x00\xe1\xf5\x05", "memo index 100000000"),
        (b"K\x012", "opcode DUP"),
        (b"\x8b\x01\x00\x00\x00\x01", "opcode LONG4"),
        (LIST * 500_000, "more than 500000 opcodes"),
    ],
)
def test_hostile_actions_are_refused(action, message):
    with pytest.raises(pickle.UnpicklingError, match=message):
        timed_actions(answer_of(pickled(4), action))


@pytest.mark.parametrize("step", [pickled(True), pickled(4.0), pickle.NONE, pickled(tensor([4]))])
def test_timestep_must_be_an_integer(step):
    with pytest.raises(pickle.UnpicklingError, match="timestep that is no integer"):
        timed_actions(answer_of(step, pickled(tensor([1.0]))))


@pytest.mark.parametrize(
    "name", [(HELPERS, "TimedAction"), REBUILD, ("torch.storage", "_load_from_bytes")]
)
def test_answer_cannot_change_what_the_next_one_needs(name):
    hostile = b"\x80\x02c" + "\n".join(name).encode() + b"\nN" + STEP_OF_7 + b"\x86b."
    with pytest.raises(pickle.UnpicklingError, match=r"sets attributes|__setstate__"):
        timed_actions(hostile)
    assert [each.timestep for each in timed_actions(OF_LEROBOT)] == [7, 8, 9]


def test_storage_of_another_type_is_refused():
    part = OF_LEROBOT.replace(b"ctorch\nFloatStorage\n", b"X\x0f\x00\x00\x00" + b"V" * 15)
    with pytest.raises(pickle.UnpicklingError, match="no storage of numbers"):
        timed_actions(part)
