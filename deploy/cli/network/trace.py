"""Import network delays that other programs measured, as traces."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bus_schema.errors import InputError
from deploy.judge.findings.link_delays import MeasuredDelays
from deploy.measure import trace_import
from deploy.measure.trace_output import scenario_lines, write_trace

app = typer.Typer(help=__doc__, no_args_is_help=True)


class Kind(StrEnum):
    """What a file may be."""

    PING = "ping"
    CANDUMP = "candump"
    CSV = "csv"
    MCAP = "mcap"


class Unit(StrEnum):
    """Units of times."""

    S = "s"
    MS = "ms"
    US = "us"
    NS = "ns"


@app.callback()
def trace() -> None:
    """Import network delays that other programs measured, as traces."""


@app.command("import")
def import_trace(
    kind: Annotated[Kind, typer.Argument(help="Program or format of the file.")],
    file: Annotated[Path, typer.Argument(help="Output of ping or candump, or a CSV or MCAP file.")],
    sent: Annotated[
        str | None,
        typer.Option("--from", help="Requests: CAN identifier (hex), CSV column or MCAP topic."),
    ] = None,
    received: Annotated[
        str | None,
        typer.Option("--to", help="Answers, likewise; MCAP without it: header stamp to log time."),
    ] = None,
    delay: Annotated[
        str | None, typer.Option(help="CSV column of delays, instead of --to.")
    ] = None,
    unit: Annotated[Unit, typer.Option(help="Unit of times in CSV.")] = Unit.S,
    interval_s: Annotated[
        float,
        typer.Option("--interval", metavar="S", help="Time between requests, for ping without -D."),
    ] = 1.0,
    least_ms: Annotated[
        float | None,
        typer.Option(
            "--least", metavar="MS", help="Smallest delay to assume, if the clocks differ."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The trace, .csv or .parquet; by default <file>_trace.csv.")
    ] = None,
) -> None:
    """Convert another program's measurement to a trace, and print the scenario lines for it.

    Of ping and of tshark's tcp.analysis.ack_rtt, each direction replays half of each round trip.
    """
    measured = _read(kind, file, sent, received, delay, unit, interval_s)
    if least_ms is not None:
        delays_ms = measured.delays_ms + (least_ms - np.nanmin(measured.delays_ms))
        measured = measured._replace(delays_ms=delays_ms)
    path = out or Path(f"{file.stem}_trace.csv")
    is_round_trip = kind is Kind.PING or delay == trace_import.ACK_ROUND_TRIP
    write_trace(measured, path, is_round_trip=is_round_trip)
    print(measured.summary())
    print("\n".join(scenario_lines({"uplink": path, "downlink": path})))


def _read(
    kind: Kind,
    file: Path,
    sent: str | None,
    received: str | None,
    delay: str | None,
    unit: Unit,
    interval_s: float,
) -> MeasuredDelays:
    if kind is Kind.PING:
        return trace_import.from_ping(file, interval_s)
    if sent is not None and sent == received:
        raise InputError(f"trace import {kind}: --from and --to must differ, both are {sent}")
    if sent is None:
        raise InputError(f"trace import {kind}: --from must be given")
    if kind is Kind.MCAP:
        return trace_import.from_mcap(file, sent, received)
    if kind is Kind.CSV:
        if (received is None) == (delay is None):
            raise InputError("trace import csv: give one of --to and --delay")
        return trace_import.from_csv(file, sent, received, delay, unit)
    if received is None:
        raise InputError("trace import candump: --to must be given")
    return trace_import.from_candump(file, sent, received)
