"""Each attribute of ``<actuator>`` in MuJoCo's schema changes what is read, or is named."""

import re

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.mujoco_library import mujoco
from bus_schema.robot_description import load_robot

ARM = """<mujoco><compiler angle="radian"/><worldbody><site name="world"/><body name="arm">
<joint name="j" range="-2 2"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="2"/>
<site name="s"/><body name="fore" pos=".4 0 0"><joint name="b" axis="0 1 0" range="-2 2"/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="2"/><site name="tip" pos=".2 0 0"/>
</body></body></worldbody>{tendon}<actuator><motor joint="j" ctrlrange="-9 9"/>{actuator}</actuator>
</mujoco>"""
TENDON = '<tendon><fixed name="t"><joint joint="b" coef="1"/></fixed></tendon>'
SERVO = {"kp": "9", "kv": "1"}
KINDS = {
    "general": {"ctrlrange": "-5 5"}, "motor": {"ctrlrange": "-5 5"}, "position": SERVO,
    "velocity": {"kv": "1"}, "intvelocity": {**SERVO, "actrange": "-1 1"}, "pid": SERVO,
    "cylinder": {"area": "2", "ctrlrange": "-5 5", "timeconst": "0.1"},
    "dcmotor": {"motorconst": "0.05", "resistance": "2", "ctrlrange": "-24 24"},
}  # fmt: skip
"""Kinds that drive a joint, each with the attributes of a plain one."""
VALUES = {
    "actlimited": "false", "actrange": "-0.5 0.5", "area": "3", "armature": "0.01",
    "bias": "1 -2 -1", "biasprm": "0 -9 -1", "biastype": "affine", "cogging": "0.1 8 0",
    "controller": "5 0 1", "cranksite": "s", "ctrllimited": "false", "ctrlrange": "-1.5 1.5",
    "damping": "0.05", "dampratio": "0.7", "delay": "0.01", "diameter": "2", "dynprm": "0.03",
    "dyntype": "filter", "ffrange": "-1 1", "forcelimited": "false", "forcerange": "-0.4 0.4",
    "gainprm": "3", "gaintype": "affine", "gear": "2", "inductance": "0.02 0",
    "inheritrange": "0.25", "input": "vel", "interp": "linear", "joint": "j", "ki": "2", "kp": "20",
    "kv": "3", "lugre": "500 1 0.2 0.5 0.6", "motorconst": "0.1", "nominal": "24 0.6 40",
    "nsample": "5", "posrange": "-1 1", "refsite": "world", "resistance": "3",
    "saturation": "0.1", "site": "tip", "slewmax": "3", "tendon": "t",
    "thermal": "1 2 0 0.004 25 25", "timeconst": "0.02", "velrange": "-2 2",
}  # fmt: skip
NO_EFFECT = {
    *("name", "class", "user", "group"),  # labels
    *("jointinparent", "lengthrange"),  # of ball joints, and of muscles
    *("actdim", "actearly"),  # of states of plugins, and within a time step
    "imax",  # of ki, which is named
    *("cranklength", "slidersite", "body"),  # of cranks, which are refused, and of adhesion
}
"""Attributes that change no force at a hinge or slide."""
OTHERS = {
    *(("general", name) for name in ("input", "ffrange", "velrange")),
    ("intvelocity", "actlimited"),
}
"""Attributes of PID controllers in the schema of others, and one that MuJoCo ignores."""
NEEDS = {
    "actlimited": {"dyntype": "filter", "actrange": "-0.5 0.5"},
    "actrange": {"dyntype": "filter", "dynprm": "0.1"},
    "biasprm": {"biastype": "affine"}, "dynprm": {"dyntype": "filter"},
    "gaintype": {"gainprm": "1 2 3"}, "biastype": {"biasprm": "0 -9 -1"},
    "controller": {"input": "pos"}, "cranksite": {"slidersite": "tip", "cranklength": "0.3"},
    "ctrllimited": {"ctrlrange": "-1.5 1.5"}, "delay": {"nsample": "80"},
    "ffrange": {"input": "pos ff"}, "forcelimited": {"forcerange": "-0.4 0.4"},
    "interp": {"nsample": "80", "delay": "0.01"}, "nsample": {"delay": "0.5", "nsample": "80"},
    "inheritrange": {"biastype": "affine", "gainprm": "9", "biasprm": "0 -9", "input": "pos"},
    "velrange": {"input": "pos vel"}, "refsite": {"site": "tip"},
}  # fmt: skip
"""What an attribute needs beside it."""
REPLACES = {"dampratio": "kv", "diameter": "area", "inheritrange": "actrange"}
TARGETS = {"cranksite", "refsite", "site", "tendon"}


def attributes_in_schema():
    """Return the attributes of each kind, as MuJoCo prints them."""
    _, text = mujoco.mj_printSchema(False, False).split(" actuator (*)")
    found = {}
    for line in text.split(" sensor (*)")[0].splitlines():
        if start := re.match(r"      (\w+) \(\*\) (.*)", line):
            kind = start[1]
        elif not line.startswith(" " * 20):  # such as the configuration of a plugin
            continue
        names = start[2] if start else line
        found.setdefault(kind, []).extend(names.split())
    return found


def tried():
    """Return the kinds and attributes to try: all of a motor once, and what else each kind has."""
    schema = attributes_in_schema()
    for kind in KINDS:
        common = set() if kind == "motor" else set(schema["motor"]) - {"ctrlrange", "gear"}
        pairs = {(kind, name) for name in schema[kind] if name not in common | NO_EFFECT}
        yield from sorted(pairs - OTHERS)


def read(tmp_path, kind, attributes):
    """Return numbers and warnings that are read from a file with an actuator of this kind."""
    words = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    tendon = TENDON if "tendon" in attributes else ""
    (tmp_path / "arm.xml").write_text(ARM.format(actuator=f"<{kind} {words}/>", tendon=tendon))
    robot = load_robot(tmp_path / "arm.xml")
    numbers = np.array([
        robot.effort_limits_nm, robot.velocity_limits_rad_s, robot.lower_rad, robot.upper_rad,
        *robot.drives,
    ])  # fmt: skip
    return [numbers.tolist(), robot.warnings]


SPINNING = """<mujoco><compiler angle="radian"/><worldbody><body>
<joint name="j" range="-3 3"{joint}/>
<geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="2"/></body></worldbody>
<actuator><dcmotor joint="j" motorconst=".5" resistance="2" ctrlrange="-24 24" {motor}/></actuator>
</mujoco>"""


@pytest.mark.parametrize(
    ("joint", "motor"),
    [("", ""), ("", 'saturation="1"'), (' actuatorfrcrange="-1 1"', ""),
     (' actuatorfrcrange="-1 1"', 'saturation="2"')],
)  # fmt: skip
def test_largest_torque_of_a_motor_falls_with_speed_as_in_mujoco(tmp_path, joint, motor):
    (tmp_path / "arm.xml").write_text(text := SPINNING.format(joint=joint, motor=motor))
    robot = load_robot(tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for speed in (0.0, 20.0, 39.0, 41.0, 44.0, 47.0):
        data.ctrl[:], data.qvel[:] = 24.0, speed
        mujoco.mj_forward(model, data)
        rated, free = robot.drives.rated_speed_rad_s[0], robot.drives.no_load_speed_rad_s[0]
        read_nm = np.interp(speed, [rated, free], [robot.effort_limits_nm[0], 0.0])
        assert read_nm == pytest.approx(data.qfrc_actuator[0], rel=1e-9)


@pytest.mark.parametrize(("kind", "name"), list(tried()))
def test_attribute_changes_what_is_read_or_is_named(tmp_path, kind, name):
    known = attributes_in_schema()[kind]
    beside = {key: each for key, each in NEEDS.get(name, {}).items() if key in known}
    plain = {"joint": "b", **KINDS[kind]}
    changed = {**plain, **beside, name: VALUES[name]}
    replaced = "joint" if name in TARGETS else REPLACES.get(name, "")
    changed.pop(replaced, None)
    before = read(tmp_path, kind, plain if name in TARGETS else {**plain, **beside})
    try:
        assert read(tmp_path, kind, changed) != before
    except RobotDescriptionError as error:
        assert re.search(r"actuator .*must drive a joint or a tendon", str(error))
