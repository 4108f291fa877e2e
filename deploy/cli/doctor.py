"""The commands `doctor` and `includes`: what this machine and this installation offer."""

from __future__ import annotations

import errno
import importlib.metadata
import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import bus_schema.runtime.compiled  # noqa: F401  (chooses where kernels are kept)
import controller.external
from bus_schema.arrays import Vector
from bus_schema.registry import REGISTRIES
from bus_schema.runtime import kernel_cache, realtime
from bus_schema.runtime.child import last_line
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.runtime.extensions import PREFIX, installed
from bus_schema.safe_path import safe_path
from controller.laws.custom import custom_laws_left_out
from deploy.cli.parts.findings import Finding, Status, show
from deploy.cli.parts.options import Overrides
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT
from deploy.run.processes.scheduling import remedy
from deploy.scenario.scenario import load_setup
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics.engines import ENGINES, engine_name

_PROCESSES = 3  # controller, plant, recorder
_LOW_DISK_BYTES = 1 << 30
_SLEEPS = 300
_SLEEP_NS = 1_000_000
_LOAD_TIMEOUT_S = 60.0
_CAN_INTERFACE_TYPE = "280"  # ARPHRD_CAN in <linux/if_arp.h>


def doctor(
    fix: Annotated[
        bool,
        typer.Option("--fix", help="Print commands that give this user real-time permissions."),
    ] = False,
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig", metavar="SCENARIO", help="Query the drives on its CAN bus, without torque."
        ),
    ] = None,
    overrides: Overrides = None,
    header: Annotated[
        bool,
        typer.Option(
            "--includes",
            help="Print the compiler option (-I…) for the C header of controller.law: external.",
        ),
    ] = False,
) -> None:
    """List what this machine offers to runs, and what each missing item costs. Changes nothing."""
    if header:
        includes()
        return
    if fix:
        print(remedy())
        return
    if rig is None:
        show(examine(), Console())
        return
    from deploy.cli.rig import examine_rig  # loads the libraries of CAN

    with custom_laws_left_out():  # no law is needed to query drives
        findings = examine_rig(load_setup(rig, overrides or []))
    show(findings, Console())
    if any(each.status == "missing" for each in findings):
        raise typer.Exit(FAULT)


def includes() -> None:
    """Print the compiler option (-I…) for the C header of controller.law: external."""
    typer.echo(f"-I{Path(controller.external.__file__).parent}")


def examine() -> list[Finding]:
    """Examine this machine. It takes a few seconds and changes no setting."""
    return [
        _python(),
        *map(_engine, ENGINES.usable()),
        _package("pinocchio", "pin", "pinocchio", "laws that use a model of the arm cannot run"),
        _package("Zenoh", "eclipse-zenoh", "zenoh", "no run over Zenoh; simulate still works"),
        _loopback(),
        _numba_cache(),
        _disk_space(),
        _cores(),
        *_realtime_settings(),
        _preemption(),
        _sleep_lateness(),
        _socketcan(),
        _display(),
        *_extensions(),
    ]


def _python() -> Finding:
    version = f"{platform.python_implementation()} {platform.python_version()}"
    return Finding("Python", "ok", version, "nothing runs without")


def _package(name: str, distribution: str, module: str, cost: str) -> Finding:
    """Check that a separate process can load a package with native code."""
    try:
        version = importlib.metadata.version(distribution)
        with safe_path():  # also for the processes that a package starts
            subprocess.run(
                [sys.executable, "-c", f"import {module}"],
                capture_output=True, text=True, check=True, timeout=_LOAD_TIMEOUT_S,
            )  # fmt: skip
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, "missing", f"{distribution} is not installed", cost)
    except subprocess.CalledProcessError as error:
        reason = last_line(error.stderr) or f"exit status {error.returncode}"
        return Finding(name, "missing", f"{version}, cannot be loaded: {reason}", cost)
    except subprocess.TimeoutExpired:
        return Finding(name, "missing", f"{version}, does not load within a minute", cost)
    return Finding(name, "ok", version, cost)


def _engine(name: str) -> Finding:
    """Check a physics engine. A run needs only one of them."""
    engine = ENGINES[name]
    cost = f"no run with plant.physics.engine={name}, and --confirm has one physics less"
    if not engine.is_installed:
        return Finding(
            engine.title, "limited", f"{engine.distribution} is not installed", f"{cost}; the"
            f" engine of scenarios that name none is {engine_name(PlantConfiguration())}",
        )  # fmt: skip
    return _package(engine.title, engine.distribution, engine.distribution, cost)


def _extensions() -> Iterator[Finding]:
    """Load all that installed packages add to funnel-hil."""
    import deploy.reports.runs.run_panels  # noqa: F401  (the registry of figures)
    import plant_emulator.drives.commissioning  # noqa: F401  (the registry of drives)

    for kind, names in installed().items():
        registry, groups = REGISTRIES.get(kind), [f"{PREFIX}{each}" for each in REGISTRIES]
        for name, extensions in names.items():
            if registry is None:
                wrong, cost = f"no such group; there are {', '.join(groups)}", "nothing reads it"
            else:
                wrong, cost = registry.problem(name), f"no run with {registry.key}={name}"
            for each in extensions:
                found = f"{each}: {wrong}" if wrong else str(each)
                yield Finding(f"extension {name}", "limited" if wrong else "ok", found, cost)


def _loopback() -> Finding:
    cost = "controller and plant cannot meet on this machine; simulate still works"
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            address = "{}:{}".format(*server.getsockname())
            with socket.create_connection(server.getsockname(), timeout=1.0):
                return Finding("loopback TCP", "ok", f"{address} could be opened", cost)
    except OSError as error:
        return Finding("loopback TCP", "missing", _reason(error), cost)


def _numba_cache() -> Finding:
    cost = "kernels not found are compiled again, for 2 to 16 s of CPU per kind of run"
    if reason := os.environ.get(kernel_cache.REFUSED):
        return Finding("numba cache", "limited", reason, cost)
    folder = Path(os.environ[kernel_cache.FOLDER])
    return Finding("numba cache", "ok", f"{_short(folder)} is writable", cost)


def _disk_space() -> Finding:
    folder = Path.cwd()
    cost = "a run fails as soon as its log can no longer be written; choose a folder by --out"
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        found = f"{_short(folder)} cannot be written: {_reason(error)}"
        return Finding("working folder", "missing", found, cost)
    free = shutil.disk_usage(folder).free
    status: Status = "ok" if free >= _LOW_DISK_BYTES else "limited"
    return Finding("working folder", status, f"{free / (1 << 30):.1f} GiB free", cost)


def _cores() -> Finding:
    cores = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else cores
    return Finding(
        "CPU cores",
        "ok" if usable >= _PROCESSES else "limited",
        f"{usable} usable of {cores}, for {_PROCESSES} processes",
        "controller, plant and recorder wait for one another: more missed deadlines in clock "
        "realtime; clock lockstep only takes longer",
    )


def _realtime_settings() -> list[Finding]:
    costs = {
        realtime.SCHEDULER: "other programs delay the loops: more missed deadlines",
        realtime.MEMORY_LOCK: "a page fault may delay a cycle",
        realtime.TIMER_SLACK: "each wake-up may come some 50 µs later",
        realtime.IDLE_STATES: "an idle CPU takes its time to wake, most of all in a virtual"
        " machine: more missed deadlines",
        realtime.PRECEDENCE: "on a busy machine the recorder falls behind and needs memory for it",
        realtime.GARBAGE_COLLECTOR: "a collection may delay a cycle",
    }
    return [
        Finding(
            each.name, "ok" if each.granted else "limited", each.detail,
            f"{costs[each.name]} in clock realtime; no effect in clock lockstep",
        )
        for each in realtime.probe()
    ]  # fmt: skip


def _preemption() -> Finding:
    kernel = os.uname()
    flag = Path("/sys/kernel/realtime")
    full = "PREEMPT_RT" in kernel.version or (flag.is_file() and flag.read_text().strip() == "1")
    models = [word for word in kernel.version.split() if word.startswith("PREEMPT")]
    model = "PREEMPT_RT" if full else " ".join(models) or "no preemption"
    return Finding(
        "kernel preemption",
        "ok" if full else "limited",
        f"{kernel.sysname} {kernel.release}, {model}",
        "nothing bounds the latest wake-up: expect rare missed deadlines in clock realtime; no "
        "effect in clock lockstep",
    )


def _sleep_lateness() -> Finding:
    # The scheduler belongs to the thread, so this one takes it along when it ends.
    with ThreadPoolExecutor(max_workers=1) as executor:
        stolen_before_ms = realtime.stolen_ms()
        granted, lateness_us = executor.submit(_measure_lateness_us).result()
    stolen_ms = realtime.stolen_ms() - stolen_before_ms
    p50, p99 = np.percentile(lateness_us, [50, 99])
    scheduler = "SCHED_FIFO" if granted else "the ordinary scheduler"
    return Finding(
        "wake-up lateness",
        "ok",
        f"p50 {p50:.0f}, p99 {p99:.0f}, max {lateness_us.max():.0f} µs over {_SLEEPS} sleeps of "
        f"1 ms under {scheduler}, while a hypervisor took {stolen_ms:.0f} ms of CPU time; varies "
        "with the load",
        "comes on top of every round trip in clock realtime; no effect in clock lockstep",
    )


def _measure_lateness_us() -> tuple[bool, Vector]:
    granted = realtime.request_fifo(50).granted
    with realtime.light_sleep():
        clock = MonotonicClock()
        lateness_ns = [clock.wait_until(tick * _SLEEP_NS) for tick in range(1, _SLEEPS + 1)]
    return granted, np.array(lateness_ns) * 1e-3


def _socketcan() -> Finding:
    cost = (
        "no real CAN interface or vcan0; a link of kind can still runs by simulate (in virtual "
        "time), and by run over link.can.interface=udp_multicast, as paper_arm_can does"
    )
    if not hasattr(socket, "AF_CAN"):
        return Finding("SocketCAN", "missing", "not known to this Python", cost)
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return Finding("SocketCAN", "missing", _reason(error), cost)
    interfaces = [
        file.parent.name
        for file in sorted(Path("/sys/class/net").glob("*/type"))
        if file.read_text().strip() == _CAN_INTERFACE_TYPE
    ]
    if not interfaces:
        return Finding("SocketCAN", "limited", "in the kernel, but no CAN interface", cost)
    return Finding("SocketCAN", "ok", f"interfaces {', '.join(interfaces)}", cost)


def _display() -> Finding:
    display = os.environ.get("DISPLAY")
    return Finding(
        "display",
        "ok" if display else "missing",
        f"DISPLAY={display}" if display else "DISPLAY is not set",
        "plant.gui=true cannot open its window; every other run is unaffected",
    )


def _reason(error: OSError) -> str:
    name = errno.errorcode.get(error.errno or 0, type(error).__name__)
    return f"{name}: {error.strerror or error}"


def _short(folder: Path) -> str:
    home = os.environ.get("HOME")
    inside = home and folder.is_relative_to(home)
    return f"~/{folder.relative_to(home)}" if home and inside else str(folder)
