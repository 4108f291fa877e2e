"""The process of a relay: between controller and plant of a `run`, or between any two programs.

Unlike an emulated delay, it includes a real connection, with the machine's scheduling, the
transport's own buffers and two separate processes.
"""

from __future__ import annotations

import socket
import time

from bus_schema.runtime.clock import utc_text
from bus_schema.runtime.realtime import go_realtime
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.network.link_relay import LinkRelay
from deploy.run.network.real_delay import RelayOptions, host_and_port
from deploy.run.processes.scheduling import report_settings
from deploy.run.processes.status import StatusReporter
from deploy.run.stop_signals import StopRequest, ignore_stops


def relay(options: RelayOptions, reporter: StatusReporter) -> int:
    """Be a relay until asked to stop, or for as long as the options say; the exit code."""
    stop = StopRequest()
    listen, target = host_and_port(options.listen), host_and_port(options.connect)
    report_settings(go_realtime(), reporter)
    family = socket.AF_INET6 if ":" in listen[0] else socket.AF_INET
    kind = socket.SOCK_DGRAM if options.is_udp else socket.SOCK_STREAM
    try:
        far = socket.getaddrinfo(*target, family, kind)[0][4][:2]
        if options.is_udp:
            listener = socket.socket(family, kind)
            listener.bind(listen)
        else:
            listener = socket.create_server(listen, family=family)
    except OSError as error:
        reporter.report(
            "fault", text=f"cannot relay {options.listen} to {options.connect}: {error}"
        )
        return FAULT
    end_s = time.monotonic() + options.duration_s
    with listener:
        relaying = LinkRelay(listener, (str(far[0]), int(far[1])), options.link, options.seed)
        place = f"{'UDP' if options.is_udp else 'TCP'} at {options.listen}"
        begun = utc_text(relaying.begun_ns)
        reporter.report("note", text=f"relaying {place} since {begun}")
        relaying.run(lambda: stop.is_set or time.monotonic() >= end_s)
    ignore_stops()
    reporter.report("result", **relaying.counts())
    return FINISHED
