"""The relay of a real delay: a process between controller and plant that holds every byte back."""

from __future__ import annotations

import socket

from bus_schema.runtime.realtime import go_realtime
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.network.delay_relay import DelayRelay
from deploy.run.network.real_delay import LONGEST_MS, RelayOptions
from deploy.run.processes.scheduling import report_settings
from deploy.run.processes.status import StatusReporter
from deploy.run.stop_signals import StopRequest, ignore_stops
from deploy.scenario.yaml_files import ScenarioError


def relay(options: RelayOptions, reporter: StatusReporter) -> int:
    """Be a relay between two TCP peers until asked to stop; the exit code."""
    stop = StopRequest()
    listen, target = tcp_address(options.listen), tcp_address(options.connect)
    if not 0.0 <= options.delay_ms <= LONGEST_MS:
        raise ScenarioError(f"--delay {options.delay_ms:g}: must be 0 to {LONGEST_MS:g} ms")
    report_settings(go_realtime(), reporter)
    family = socket.AF_INET6 if ":" in listen[0] else socket.AF_INET
    try:
        listener = socket.create_server(listen, family=family)
    except OSError as error:
        reporter.report("fault", text=f"cannot listen at {listen[0]}:{listen[1]}: {error}")
        return FAULT
    with listener:
        held_back = DelayRelay(listener, target, round(options.delay_ms * 1e6))
        place = f"{listen[0]}:{listen[1]}"
        reporter.report("note", text=f"holds back by {options.delay_ms:g} ms each way at {place}")
        held_back.run(lambda: stop.is_set)
    ignore_stops()
    reporter.report("result", chunks=held_back.chunks, lateness_us=held_back.lateness_us())
    return FINISHED


def tcp_address(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT.

    Raises:
        ScenarioError: it is something else.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and 0 < int(port) < 1 << 16):
        raise ScenarioError(f"{text!r}: must be HOST:PORT such as 127.0.0.1:7453")
    return host.strip("[]"), int(port)
