"""Import network delays that other programs measured, as traces."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from bus_schema.errors import InputError
from bus_schema.time_units import Unit, check_interval, split_unit, units_of
from deploy.judge.findings.link_delays import MeasuredDelays
from deploy.measure import trace_import
from deploy.measure.clocks import at_least, drift_ppm, without_drift
from deploy.measure.trace_output import scenario_lines, write_trace
from plant_emulator.channel.round_trips import ACK_ROUND_TRIP, ROUND_TRIPS
from plant_emulator.channel.trace_file import read_trace

app = typer.Typer(help=__doc__, no_args_is_help=True)


class Kind(StrEnum):
    """Format of a file of delays."""

    PING = "ping"
    CANDUMP = "candump"
    CSV = "csv"
    MCAP = "mcap"


_FOREIGN = (Kind.CANDUMP, Kind.CSV, Kind.MCAP)
_READ_BY = {
    "--from": _FOREIGN, "--to": _FOREIGN, "--delay": (Kind.CSV,), "--unit": (Kind.CSV,),
    "--delay-unit": (Kind.CSV,), "--interface": (Kind.CANDUMP,), "--interval": (Kind.PING,),
    "--one-clock": (Kind.CSV, Kind.MCAP), "--round-trip": (Kind.CSV,),
}  # fmt: skip
"""The kinds that read an option."""
_READ_AS = {
    True: "column {} is read as round trips, half of each in each direction; else: --one-way",
    False: "column {} is read as one-way delays, all of each in each direction; else: --round-trip",
}


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
    unit: Annotated[
        Unit | None,
        typer.Option(
            help="Unit of CSV columns whose names, unlike sent_ns, do not say it."
            r"  \[default: s]"
        ),
    ] = None,
    delay_unit: Annotated[
        Unit | None, typer.Option(help="Unit of --delay, if it is another.", show_default=False)
    ] = None,
    interface: Annotated[
        str | None, typer.Option(help="The only bus to read of candump, as can0.")
    ] = None,
    interval_s: Annotated[
        float | None,
        typer.Option(
            "--interval",
            metavar="S",
            help="Time between requests, for ping without -D."
            r"  \[default: as its last lines say, or 1]",
        ),
    ] = None,
    least_ms: Annotated[
        float | None,
        typer.Option(
            "--least", metavar="MS", help="Smallest delay to assume, if the clocks differ."
        ),
    ] = None,
    one_clock: Annotated[
        bool,
        typer.Option(
            "--one-clock", help="Sent and received times are of one clock: keep delays that grow."
        ),
    ] = False,
    round_trip: Annotated[
        bool | None,
        typer.Option(
            "--round-trip/--one-way",
            help="The CSV column --delay has round trips, of which each direction takes half."
            r"  \[default: by its name]",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The trace, .csv or .parquet; by default <file>_trace.csv.")
    ] = None,
) -> None:
    """Convert another program's measurement to a trace, and print the scenario lines for it.

    Of ping and of tshark's tcp.analysis.ack_rtt, each direction replays half of each round trip.
    If a log of candump has several buses with both frames, each becomes a trace.
    """
    _refuse_options_without_effect(
        kind,
        {"--from": sent, "--to": received, "--delay": delay, "--unit": unit,
         "--delay-unit": delay_unit, "--interface": interface, "--interval": interval_s,
         "--one-clock": one_clock or None, "--round-trip": round_trip},
    )  # fmt: skip
    has_two_clocks = (kind is Kind.MCAP and not received) or (kind is Kind.CSV and not delay)
    if one_clock and not has_two_clocks:
        other = "--to" if kind is Kind.MCAP else "--delay"
        raise InputError(f"trace import {kind}: --one-clock must be left out with {other}")
    measurements = _read(kind, file, _Names(sent, received, delay), interval_s, interface,
                         (unit, delay_unit))  # fmt: skip
    path = out or Path(f"{file.stem}_trace.csv")
    is_round_trip = kind is Kind.PING or _has_round_trips(delay, round_trip)
    for bus, measured in measurements.items():
        own = path if len(measurements) == 1 else path.with_stem(f"{path.stem}_{_word(bus)}")
        try:
            check_interval(measured.sent_s)
            ppm = drift_ppm(measured) if has_two_clocks and not one_clock else 0.0
            if is_round_trip and kind is Kind.CSV:
                measured = MeasuredDelays(measured.sent_s, 0.5 * measured.delays_ms)
            measured = at_least(without_drift(measured, ppm), least_ms)
        except ValueError as error:
            raise InputError(f"{file}: {error}") from error
        write_trace(measured, own, is_round_trip=is_round_trip)
        print(f"{bus}: {measured.summary()}" if bus else measured.summary())
        if delay is not None and delay != ACK_ROUND_TRIP and round_trip is None:
            print(_READ_AS[is_round_trip].format(delay))
        if sparse := read_trace(own).sparse_text:
            print(f"warning: {own}: {sparse}")
        if ppm:
            print(_drift_sentence(ppm, measured))
        print("\n".join(scenario_lines({"uplink": own, "downlink": own})))


def _has_round_trips(delay: str | None, asked: bool | None) -> bool:
    """Whether a column of delays has round trips: as asked, else by its name."""
    if asked is not None and delay is None:
        raise InputError("trace import csv: --round-trip and --one-way are for --delay")
    is_named = delay == ACK_ROUND_TRIP or split_unit(delay or "")[0] in ROUND_TRIPS
    return is_named if asked is None else asked


class _Names(NamedTuple):
    """The user's names of requests, answers and delays: identifiers, columns or topics."""

    sent: str | None
    received: str | None
    delay: str | None


def _refuse_options_without_effect(kind: Kind, given: Mapping[str, object]) -> None:
    for option, value in given.items():
        if value is not None and kind not in _READ_BY[option]:
            owners = " and ".join(_READ_BY[option])
            raise InputError(f"trace import {kind}: {option} is for {owners}")


def _read(
    kind: Kind, file: Path, names: _Names, interval_s: float | None, interface: str | None,
    units: tuple[Unit | None, Unit | None],
) -> dict[str, MeasuredDelays]:  # fmt: skip
    """Return the measurements of a file by their bus, whose name is empty except for candump."""
    sent, received, delay = names
    if kind is Kind.PING:
        return {"": trace_import.from_ping(file, interval_s)}
    if sent is not None and sent == received:
        raise InputError(f"trace import {kind}: --from and --to must differ, both are {sent}")
    if sent is None:
        raise InputError(f"trace import {kind}: --from must be given")
    if kind is Kind.MCAP:
        return {"": trace_import.from_mcap(file, sent, received)}
    if kind is Kind.CSV:
        return {"": _read_csv(file, sent, received, delay, units)}
    if received is None:
        raise InputError("trace import candump: --to must be given")
    return trace_import.from_candump(file, sent, received, interface)


def _read_csv(
    file: Path, sent: str, received: str | None, delay: str | None,
    units: tuple[Unit | None, Unit | None],
) -> MeasuredDelays:  # fmt: skip
    """Read two columns, each in the unit that its name or an option says; print these units."""
    end = received or delay
    if end is None or (received and delay):
        raise InputError("trace import csv: give one of --to and --delay")
    if units[1] and not delay:
        raise InputError("trace import csv: --delay-unit must be left out without --delay")
    own = units_of([sent] if units[1] else [sent, end], units[0], "trace import csv: --unit")
    if units[1]:
        own[end] = units[1]
    print("units: " + ", ".join(f"{name} in {unit}" for name, unit in own.items()))
    return trace_import.from_csv(file, sent, received, delay, own)


def _drift_sentence(ppm: float, measured: MeasuredDelays) -> str:
    """Say which drift was removed, and what remains unknown."""
    span_s = float(np.ptp(measured.sent_s))
    return (
        f"the clocks drift by {ppm:.2f} ppm, {abs(ppm) * span_s / 1e3:.3g} ms in {span_s:.4g} s:"
        " removed from the first message on; how far they are apart there is unknown"
    )


def _word(text: str) -> str:
    """Return a text for the name of a file."""
    return re.sub(r"[^0-9A-Za-z]+", "_", text)
