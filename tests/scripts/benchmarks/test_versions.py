"""Two versions of the repository are compared in one run."""

import pytest

from scripts.benchmarks import versions

OURS = versions.ROOT
PLAIN = ["plain, MuJoCo"]


def test_ticks_of_two_versions_are_compared_in_turn():
    """The same version twice: the ratio is that of its two costs, in each repetition."""
    section = versions.compare({"old": OURS, "new": OURS}, PLAIN, seconds=0.02, repetitions=1)
    (found,) = section.ratios
    assert found.name == "plain, MuJoCo, new / plain, MuJoCo, old"
    old, new = (section.costs_us[f"plain, MuJoCo, {name}"].samples for name in ("old", "new"))
    assert found.value.samples == pytest.approx([b / a for a, b in zip(old, new, strict=True)])


def test_a_version_that_cannot_run_a_kind_is_named(tmp_path):
    (tmp_path / "deploy").mkdir()
    (tmp_path / "deploy/__init__.py").touch()
    with pytest.raises(RuntimeError, match=rf"{tmp_path}: plain, MuJoCo: (?s:.*)No module"):
        versions.tick_us(tmp_path, *PLAIN, seconds=0.02)
