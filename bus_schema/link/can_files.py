"""The descriptions of the drives' protocols that both sides read: an EDS and a DBC."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

CIA402_EDS = Path(str(resources.files("bus_schema").joinpath("can", "cia402_drive.eds")))
CANSIMPLE_DBC = Path(str(resources.files("bus_schema").joinpath("can", "cansimple.dbc")))
