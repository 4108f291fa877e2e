"""Units in names: ``torque_nm`` is a torque in N m."""

from __future__ import annotations

_UNITS = {
    "nm_per_s": "N m/s", "nm_rad": "N m/rad", "nm_s": "N m s/rad", "nm": "N m", "per_s": "1/s",
    "rad_s3": "rad/s³", "rad_s2": "rad/s²", "rad_s": "rad/s", "mrad": "mrad", "rad": "rad",
    "kg_m2": "kg m²", "kg": "kg", "kbit_s": "kbit/s", "m_s": "m/s", "us": "µs", "ms": "ms",
    "s": "s", "hz": "Hz", "mm": "mm", "m": "m",
}  # fmt: skip
"""By the ends of names, the longest first."""
_RATES = ("torque_rate_nm_s", "torque_rate_limit_nm_s")
"""Ends of names of torques per time: of other names, ``nm_s`` is a damping."""


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without its unit, and the unit; an empty one for none, as of a share."""
    if name.startswith("share_"):  # its end is the unit of a limit, as in share_above_50_hz
        return name, ""
    for end, unit in _UNITS.items():
        if name.endswith(f"_{end}"):
            return name.removesuffix(f"_{end}"), "N m/s" if name.endswith(_RATES) else unit
    return name, ""
