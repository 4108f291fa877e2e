"""The relay as a process."""

from __future__ import annotations

import socket

from bus_schema.runtime.realtime import go_realtime
from deploy.exit_codes import FAULT, FINISHED
from deploy.processes.network.delay_relay import DelayRelay
from deploy.processes.processes import StopRequest
from deploy.processes.scheduling import report_settings
from deploy.processes.status import StatusReporter
from deploy.stop_signals import ignore_stops


def run_relay(
    listen: tuple[str, int], target: tuple[str, int], delay_ms: float, reporter: StatusReporter
) -> int:
    """Be the relay between two TCP peers until asked to stop; the exit code.

    Args:
        listen: host and port where connections come in.
        target: host and port that they are passed on to.
        delay_ms: how long bytes are held back, each way.
        reporter: where to report how late they left.
    """
    stop = StopRequest()
    report_settings(go_realtime(), reporter)
    family = socket.AF_INET6 if ":" in listen[0] else socket.AF_INET
    try:
        listener = socket.create_server(listen, family=family)
    except OSError as error:
        reporter.report("fault", text=f"cannot listen at {listen[0]}:{listen[1]}: {error}")
        return FAULT
    with listener:
        relay = DelayRelay(listener, target, round(delay_ms * 1e6))
        reporter.report(
            "note", text=f"holds back by {delay_ms:g} ms each way at {listen[0]}:{listen[1]}"
        )
        relay.run(lambda: stop.is_set)
    ignore_stops()
    reporter.report("result", chunks=relay.chunks, lateness_us=relay.lateness_us())
    return FINISHED
