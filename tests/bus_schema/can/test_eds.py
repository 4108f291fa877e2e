"""A description of drives that the master cannot use is refused, with the object that is wrong."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bus_schema.can.cia402.canopen_adapter import (
    _MAPPED,
    _MAPPED_TORQUE,
    _USED,
    _USED_WITH_TARGETS,
    check_eds,
)
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CIA402_EDS


def section(text: str, name: str) -> str:
    """One section of the shipped description, with its heading."""
    return text[text.index(f"[{name}]") :].split("\n[")[0]


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("6071", ("[6071]", "[5999]"), "it lacks 0x6071"),
        ("6041", ("DataType=0x0006", "DataType=0x0007"), "0x6041 has data type 0x0007, not 0x0006"),
        ("608Fsub1", ("DataType=0x0007", "DataType=0x0005"), "0x608F:01 has data type 0x0005"),
        ("1600sub2", ("0x60710010", "0x60FF0020"), "0x1600:02 maps 0x60FF0020, not 0x60710010"),
        ("1A00sub0", ("DefaultValue=2", "DefaultValue=1"), "0x1A00 maps 1 object, not 2 objects"),
    ],
)
def test_object_that_does_not_fit_is_named(tmp_path, name, change, words):
    text = CIA402_EDS.read_text()
    eds = tmp_path / "drive.eds"
    eds.write_text(text.replace(found := section(text, name), found.replace(*change, 1)))
    with pytest.raises(ConfigurationError, match=re.escape(f"{eds}': must describe a")) as refused:
        check_eds(str(eds), takes_targets=False)
    assert words in str(refused.value)


def test_objects_of_position_mode_are_needed_with_targets_only(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(CIA402_EDS.read_text().replace("[607A]", "[5999]"))
    check_eds(str(eds), takes_targets=False)
    with pytest.raises(ConfigurationError, match="it lacks 0x607A"):
        check_eds(str(eds), takes_targets=True)


@pytest.mark.parametrize(
    ("default", "parameter", "words"),
    [
        ("0x60FF0020", "0x60710010", None),
        ("0x60710010", "0x60FF0020", "0x1600:02 maps 0x60FF0020, not 0x60710010"),
        ("0x60710010", "0x0", "0x1600:02 maps nothing, not 0x60710010"),
    ],
)
def test_parameter_value_of_a_dcf_takes_the_place_of_the_default(
    tmp_path: Path, default: str, parameter: str, words: str | None
) -> None:
    text = CIA402_EDS.read_text()
    found = section(text, "1600sub2")
    values = f"DefaultValue={default}\nParameterValue={parameter}"
    dcf = tmp_path / "drive.dcf"
    dcf.write_text(text.replace(found, found.replace("DefaultValue=0x60710010", values)))
    if words is None:
        check_eds(str(dcf), takes_targets=False)
        return
    with pytest.raises(ConfigurationError, match=words):
        check_eds(str(dcf), takes_targets=False)


def test_page_names_every_object_that_a_drive_must_have() -> None:
    """The table on the CAN page and the check have the same objects."""
    page = (
        Path(check_eds.__code__.co_filename).parents[3] / "deploy/docs/how-to/can.md"
    ).read_text()
    table = page.split("## Drives of a third party")[1].split("\n## ")[0]
    named = {int(index, 16) for index in re.findall(r"0x([0-9A-F]{4})\b", table)}
    used = _USED + _USED_WITH_TARGETS + _MAPPED + _MAPPED_TORQUE
    missing = {index for index, _ in used} - named
    assert not missing, [f"0x{index:04X}" for index in sorted(missing)]
