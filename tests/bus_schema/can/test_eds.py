"""A description of drives that the master cannot use is refused, with the object that is wrong."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bus_schema.can.cia402.canopen_adapter import check_eds
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CIA402_EDS


def section(text: str, name: str) -> str:
    """One section of the shipped description, with its heading."""
    return text[text.index(f"[{name}]") :].split("\n[")[0]


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("6071", ("[6071]", "[5999]"), "it lacks 0x6071"),
        ("6041", ("DataType=0x0006", "DataType=0x0007"), "0x6041 has data type 0x0007, not 0x0006"),
        ("608Fsub1", ("DataType=0x0007", "DataType=0x0005"), "0x608F:01 has data type 0x0005"),
        ("1600sub2", ("0x60710010", "0x60FF0020"), "0x1600:02 maps 0x60FF0020, not 0x60710010"),
        ("1A00sub0", ("DefaultValue=2", "DefaultValue=1"), "0x1A00 maps 0x00000001, not"),
    ],
)
def test_object_that_does_not_fit_is_named(
    tmp_path: Path, name: str, change: tuple[str, str], said: str
) -> None:
    text = CIA402_EDS.read_text()
    eds = tmp_path / "drive.eds"
    eds.write_text(text.replace(found := section(text, name), found.replace(*change, 1)))
    with pytest.raises(ConfigurationError, match=re.escape(f"{eds}': must describe a")) as refused:
        check_eds(str(eds), takes_targets=False)
    assert said in str(refused.value)


def test_objects_of_position_mode_are_needed_with_targets_only(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(CIA402_EDS.read_text().replace("[607A]", "[5999]"))
    check_eds(str(eds), takes_targets=False)
    with pytest.raises(ConfigurationError, match="it lacks 0x607A"):
        check_eds(str(eds), takes_targets=True)
