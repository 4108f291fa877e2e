"""The fuzz of the guarantee that all patterns below a play-out time act alike."""

from __future__ import annotations

import random
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from deploy.scenario.scenario import load_setup
from plant_emulator.channel.delay_range import largest_delay_ns
from scripts.experiments import patterns_one_digest as fuzz


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two light settings, on a thread of this process."""
    monkeypatch.setattr(fuzz, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setattr(fuzz, "SETTINGS", (fuzz.SETTINGS[1], fuzz.SETTINGS[7]))


@pytest.mark.usefixtures("in_this_process")
def test_patterns_have_one_digest_for_each_setting(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(patterns=8, workers=1, first=100) == 0
    _, _, *rows, counts = capsys.readouterr().out.splitlines()
    assert [row.split(" | ")[-2:] for row in rows] == [["4", "1 |"]] * 2
    assert counts == "8 patterns, 0 late commands"


@pytest.mark.usefixtures("in_this_process")
def test_delays_beyond_d_have_other_digests(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def beyond(numbers: random.Random, setting: fuzz.Setting, _folder: Path) -> tuple[str, ...]:
        return (f"link.uplink.delay_ms={setting.playout_ms + numbers.choice([0, 30])}",)

    monkeypatch.setattr(fuzz, "drawn", beyond)
    assert fuzz.main(patterns=12, workers=1, first=0) == 1
    assert "another digest: paper_arm, " in capsys.readouterr().out


def test_no_pattern_exceeds_d_and_many_reach_it(tmp_path: Path) -> None:
    largest_ns = []
    for number in range(90):
        setting = fuzz.SETTINGS[number % len(fuzz.SETTINGS)]
        link = fuzz.drawn(random.Random(number), setting, tmp_path)
        loaded = load_setup(setting.arm, [*setting.common, *link]).link
        ways = [largest_delay_ns(each) for each in (loaded.uplink, loaded.downlink)]
        assert None not in ways
        largest_ns.append(sum(filter(None, ways)) - round(1e6 * setting.playout_ms))
    assert max(largest_ns) == 0
    assert np.count_nonzero(np.array(largest_ns) == 0) > 30
