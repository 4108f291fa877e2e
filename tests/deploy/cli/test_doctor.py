from __future__ import annotations

import errno
import importlib.metadata
import io
import os
import shutil
import socket
from typing import Any, NoReturn

import pytest
from rich.console import Console

from bus_schema.runtime import kernel_cache, realtime
from deploy.cli.doctor import examine
from deploy.cli.parts.findings import Finding, show
from plant_emulator.physics.engines import ENGINES

WIDTH = 80


@pytest.fixture(scope="module")
def findings() -> list[Finding]:
    return examine()


@pytest.fixture
def bare_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that grants nothing a program can be refused."""

    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))

    def not_installed(name: str) -> NoReturn:
        raise importlib.metadata.PackageNotFoundError(name)

    names = (realtime.SCHEDULER, realtime.MEMORY_LOCK, realtime.TIMER_SLACK)
    refused = [realtime.RealtimeSetting(name, False, "refused") for name in names]
    monkeypatch.setattr(realtime, "probe", lambda: refused)
    monkeypatch.setattr(type(ENGINES["bullet"]), "is_installed", True)  # so it seems, until loaded
    monkeypatch.setattr(importlib.metadata, "version", not_installed)
    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_server", refuse)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 0))
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    monkeypatch.setenv(kernel_cache.REFUSED, "no compiled kernels can be kept")
    monkeypatch.delenv("DISPLAY", raising=False)


def rendered(findings: list[Finding]) -> list[str]:
    console = Console(width=WIDTH, record=True, file=io.StringIO())
    show(findings, console)
    return console.export_text().splitlines()


def without_blanks(text: str) -> str:
    return "".join(text.split())


def shown_texts(lines: list[str]) -> str:
    """The last column, without the blanks that wrapping moves."""
    start = lines[0].index("Found")
    return without_blanks("".join(line[start:] for line in lines[1:]))


def test_the_table_keeps_every_word_on_80_columns(findings: list[Finding]) -> None:
    lines = rendered(findings)
    assert max(map(len, lines)) <= WIDTH
    texts = shown_texts(lines)
    for finding in findings:
        assert without_blanks(finding.found) in texts
        assert any(line.split(finding.status)[0].strip() == finding.name for line in lines)
        assert (without_blanks(finding.cost) in texts) == (finding.status != "ok")


@pytest.mark.usefixtures("bare_machine")
def test_doctor_lists_the_cost_of_every_missing_item() -> None:
    findings = {finding.name: finding for finding in examine()}
    missing = {"Bullet", "MuJoCo", "pinocchio", "Zenoh", "loopback TCP", "SocketCAN", "display"}
    limited = {"numba cache", "working folder", "CPU cores", realtime.SCHEDULER}
    assert {name for name, finding in findings.items() if finding.status == "missing"} == missing
    assert limited <= {name for name, finding in findings.items() if finding.status == "limited"}
    texts = shown_texts(rendered(list(findings.values())))
    assert all(without_blanks(findings[name].cost) in texts for name in missing | limited)
    assert "EAFNOSUPPORT" in findings["SocketCAN"].found


def test_python_without_bullet_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(ENGINES["bullet"]), "is_installed", False)
    (bullet,) = (finding for finding in examine() if finding.name == "Bullet")
    assert (bullet.status, bullet.found) == ("limited", "pybullet is not installed")
    assert "the engine of scenarios that name none is mujoco" in bullet.cost
