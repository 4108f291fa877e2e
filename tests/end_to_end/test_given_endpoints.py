"""`run` on endpoints that the user gives."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import yaml
from running import free_endpoint, funnel_hil, settings


def test_run_listens_where_it_is_told(tmp_path: Path) -> None:
    plant = free_endpoint()
    given = settings(clock="lockstep", duration_s=0.1, link__plant_endpoint=plant)
    ended = funnel_hil("run", "paper_arm", *given, out=tmp_path / "run")
    assert ended.code == 0, ended.output
    link = json.loads((ended.folder / "manifest.json").read_text())["scenario"]["link"]
    assert link["plant_endpoint"] == plant
    assert link["controller_endpoint"] not in {plant, "tcp/127.0.0.1:7452"}
    # What is left to be run again has what was given, and no place that was free once.
    link = yaml.safe_load((ended.folder / "scenario.yaml").read_text())["link"]
    assert link["plant_endpoint"] == plant
    assert "controller_endpoint" not in link


def test_run_does_not_begin_where_it_cannot_listen(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        given = settings(clock="lockstep", duration_s=0.1, link__controller_endpoint=taken)
        ended = funnel_hil("run", "paper_arm", *given, out=tmp_path / "run")
    assert ended.code == 2
    assert f"link.controller_endpoint = '{taken}': must be an endpoint that" in ended.output
    assert "Traceback" not in ended.output
    assert not ended.folder.exists()
