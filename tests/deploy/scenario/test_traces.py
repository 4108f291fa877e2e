"""Traces in scenarios: shipped ones, their content in all that must agree, margins of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.run.simulate import simulate
from deploy.scenario.effective import agreement_of
from deploy.scenario.referenced_files import TRACES
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.trace_file import read_trace

LARGEST_BYTES = 100_000
SHORT = ["duration_s=0.3", "link.uplink.trace.file=wifi_idle"]


@pytest.mark.parametrize("path", sorted(TRACES.glob("*")), ids=lambda path: path.stem)
def test_shipped_trace_is_a_minute_and_small(path: Path) -> None:
    trace = read_trace(path)
    assert trace.length_ns == 60 * 10**9
    assert path.stat().st_size < LARGEST_BYTES
    assert load_setup("paper_arm", [f"link.downlink.trace.file={path.stem}"])


def test_trace_begins_elsewhere_with_another_seed() -> None:
    digests = {
        simulate(load_setup("paper_arm", [*SHORT, f"seed={s}"])).data().digest for s in (1, 2)
    }
    again = simulate(load_setup("paper_arm", [*SHORT, "seed=2"])).data().digest
    assert len(digests) == 2
    assert again in digests


def test_run_keeps_its_trace(tmp_path: Path, funnel_hil) -> None:
    own = tmp_path / "own.parquet"
    own.write_bytes((TRACES / "5g.parquet").read_bytes())
    out = tmp_path / "run"
    setting = f"link.uplink.trace.file={own}"
    funnel_hil.output(
        "simulate", "paper_arm", "--set", setting, "--set", "duration_s=0.3", "--out", out
    )
    own.unlink()
    funnel_hil.output("replay", out)
    digest = json.loads((out / "summary.json").read_text())["digest"]
    assert simulate(load_setup(str(out / "scenario.yaml"))).data().digest == digest
    assert "The link compared with its trace" in (out / "report.html").read_text()


def test_hosts_agree_on_what_the_trace_holds(tmp_path: Path) -> None:
    announced = {}
    for name, delay in (("one", 1), ("same", 1), ("other", 2)):
        (tmp_path / name).mkdir()
        file = tmp_path / name / "trace.csv"
        file.write_text(f"time_s,delay_ms\n0,{delay}\n1,{delay}\n")
        announced[name] = agreement_of(load_setup("paper_arm", [f"link.uplink.trace.file={file}"]))
    assert announced["one"].differences(announced["same"].encode()) == []
    differing = announced["one"].differences(announced["other"].encode())
    assert differing == ["link.uplink.trace.file"]
    for_parquet = [
        agreement_of(load_setup("paper_arm", [f"link.uplink.trace.file={name}"]))
        for name in ("5g", "vpn")
    ]
    assert for_parquet[0].differences(for_parquet[1].encode()) == ["link.uplink.trace.file"]


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        (
            ["link.uplink.trace.file=wifi"],
            "no such file, nor one of the shipped traces .*wifi_idle",
        ),
        (["link.uplink.trace={file: vpn, start_s: 61}"], r"start_s = 61.0: must be below .* 60 s"),
        (
            ["link.uplink.trace={file: vpn, start_s: 50, loop: false}", "duration_s=12"],
            "trace.loop = False: must be true, because the trace lasts only 10 s after start_s",
        ),
        (["link.uplink.trace={file: vpn, scale: -1}"], "scale = -1: must be greater than or equal"),
    ],
)
def test_trace_that_does_not_fit_is_refused(settings: list[str], complaint: str) -> None:
    with pytest.raises(ScenarioError, match=complaint):
        load_setup("paper_arm", settings)


def test_trace_that_repeats_between_two_messages_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "trace.csv"
    file.write_text("time_s,delay_ms\n0,1\n0.000000001,2\n")
    setting = f"link.uplink.trace.file={file}"
    with pytest.raises(ScenarioError, match=r"at least one period of the loop, 0\.001 s"):
        load_setup("paper_arm", [setting])
    file.write_text("time_s,delay_ms\n0,1\n0.0005,2\n")
    assert load_setup("paper_arm", [setting])


def test_margin_says_how_much_worse_the_network_may_get(tmp_path: Path, funnel_hil) -> None:
    funnel_hil.output(
        "margin", "paper_arm", "--quantity", "link.uplink.trace.scale", "--laws", "pid",
        "--set", "link.uplink.trace={file: vpn, start_s: 0}", "--set", "duration_s=0.4",
        "--limit", "3", "--resolution", "1", "--out", tmp_path / "margin",
    )  # fmt: skip
    found = json.loads((tmp_path / "margin" / "summary.json").read_text())
    values = {probe["value"] for case in found["cases"] for probe in case["probes"]}
    assert values <= {1.0, 2.0, 3.0}
