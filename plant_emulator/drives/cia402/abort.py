"""SDO abort codes that the drive's dictionary can give (CiA 301, table 22 of 7.2.4.3.17)."""

from __future__ import annotations

from enum import IntEnum


class Abort(IntEnum):
    """Why an SDO transfer was refused."""

    UNKNOWN_COMMAND = 0x0504_0001
    OUT_OF_MEMORY = 0x0504_0005
    UNSUPPORTED_ACCESS = 0x0601_0000
    READ_ONLY = 0x0601_0002
    NO_SUCH_OBJECT = 0x0602_0000
    NOT_MAPPABLE = 0x0604_0041
    PDO_TOO_LONG = 0x0604_0042
    INCOMPATIBLE = 0x0604_0043
    NO_SUCH_SUBINDEX = 0x0609_0011
    INVALID_VALUE = 0x0609_0030
    TOO_HIGH = 0x0609_0031
    TOO_LOW = 0x0609_0032
    MAXIMUM_BELOW_MINIMUM = 0x0609_0036
    NO_DATA = 0x0800_0024
