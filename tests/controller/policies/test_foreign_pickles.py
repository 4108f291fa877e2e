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
from tests.controller.policies.servers import ClassesOfTheServer, action_pickle

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
