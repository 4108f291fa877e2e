"""Every result says under what conditions it came about."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace

from pyarrow import parquet

from deploy.judge.conditions import conditions_of_recording, host_of, seeds_text
from deploy.run.run_folder import load_run, read_manifest

SHORT = ("--set", "duration_s=0.05", "--set", "metrics.from_s=0")


def conditions_on(page):
    card = page.partition('id="conditions"')[2].partition("</section>")[0]
    pairs = re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", card)
    return {name: html.unescape(text) for name, text in pairs}


def metadata_of(file):
    metadata = parquet.read_schema(file).metadata
    return {k.decode(): v.decode() for k, v in metadata.items() if k != b"funnel_hil.sha256"}


def test_a_run_says_what_it_is_in_its_report_and_the_terminal(tmp_path, funnel_hil):
    output = funnel_hil.output(
        "simulate", "paper_arm", *SHORT, "--set", "seed=7", "--out", tmp_path
    )
    page = (tmp_path / "report.html").read_text()
    conditions = conditions_on(page)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert conditions["date"] == manifest["started"]
    assert conditions["version"] == f"funnel-hil {manifest['versions']['funnel-hil']}"
    assert conditions["set"] == "duration_s=0.05, metrics.from_s=0, seed=7"
    assert (conditions["law"], conditions["duration"], conditions["seeds"]) == (
        "fixed_time_neural", "0.05 s", "one (seed 7)",
    )  # fmt: skip
    assert conditions["starts"].startswith("initial offset")
    shown = ("version", "scenario", "law", "physics", "duration", "seeds", "set")
    assert all(f"{name}: {conditions[name]}" in output for name in shown)
    assert "The report has all conditions." in output


def test_a_table_of_margins_is_quotable_alone(tmp_path, funnel_hil):
    two_seeds = ("--seeds", "2")  # of which one is run, as nothing is random
    words = ("--laws", "smc", *two_seeds, "--limit", "1", "--resolution", "1")
    funnel_hil.output("margin", "paper_arm", *words, *SHORT, "--workers", "1", "--out", tmp_path)
    text = (tmp_path / "table.md").read_text()
    table, title, *_ = text.split("\n\n")
    line = text.rstrip().splitlines()[-1]
    assert "largest round trip" in title
    assert table.startswith("| law |")
    for part in ("quantity: round trip (ms) up to 1, found to within 1", "law: smc",
                 "seeds: one (seed 1);", "starts: initial offset × 1, -0.5", "paper_arm 0.05 s",
                 "metrics.from_s=0", "version: funnel-hil", "date: 20", "CPUs usable"):  # fmt: skip
        assert part in line
    conditions = metadata_of(tmp_path / "margin.parquet")
    assert all(f"{name}: {value}" in line for name, value in conditions.items())
    page = (tmp_path / "report.html").read_text()
    assert f"<dd>{conditions['quantity']}</dd>" in page


def test_granted_settings_are_listed_by_process():
    settings = [
        {"name": "real-time scheduler", "granted": True, "detail": "SCHED_FIFO, priority 50"},
        {"name": "CPU affinity", "granted": True, "detail": "CPU 1"},
        {"name": "timer slack", "granted": True, "detail": "0 ns"},
    ]
    refused = [{"name": "real-time scheduler", "granted": False, "detail": "not permitted"}]
    reported = host_of({"realtime": {"plant": settings, "controller": refused}})["granted"]
    assert reported == "plant SCHED_FIFO, priority 50, CPU 1; controller no real-time scheduler"


def test_settings_that_no_loop_reported_are_unknown(tmp_path, funnel_hil):
    """A recorder that was started by hand knows nothing of the loops but what they send."""
    funnel_hil("simulate", "paper_arm", *SHORT, "--no-report", "--out", tmp_path)
    simulated, manifest = load_run(tmp_path)[0], read_manifest(tmp_path)
    in_real_time = replace(simulated, clock="realtime")
    reported = {
        "realtime": {"plant": [{"name": "CPU affinity", "granted": True, "detail": "CPU 1"}]}
    }
    granted = [
        conditions_of_recording(run, {**manifest, **more})["granted"]
        for run, more in ((simulated, {}), (in_real_time, {}), (in_real_time, reported))
    ]
    assert granted[0] == "no real-time permissions, because no loop ran in real time"
    assert granted[1].startswith("not known")
    assert granted[2] == "plant CPU 1"


def test_the_number_of_seeds_is_told_from_their_names():
    assert seeds_text([1]) == "one (seed 1)"
    assert seeds_text([3, 4]) == "2 (seeds 3, 4)"
    assert seeds_text([*range(1, 21)], 6) == "20 (seeds 1 … 20)"
