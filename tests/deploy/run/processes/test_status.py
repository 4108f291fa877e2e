"""What a process reports about itself, as people read it."""

from __future__ import annotations

import pytest

from deploy.run.processes.status import StatusReporter, in_words


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"ticks": 500, "wall_s": 0.5}, "ticks 500, wall 0.5 s"),
        ({"cycles": 3, "seed_used": False}, "cycles 3, no random numbers drawn"),
        ({"seed_used": True, "completed": False}, "random numbers drawn, not completed"),
        ({"late": 0, "kernel": 2724810705, "newest_cycle_s": 1.1e4, "start_s": 3.5}, "late 0"),
        ({"rejected": {"stale": 2, "late": 0}, "limits": {}}, "rejected: stale 2, limits: none"),
    ],
)
def test_values_read_as_words(values, words: str) -> None:
    assert in_words(values) == words


def test_result_of_a_process_names_no_clock(capsys) -> None:
    StatusReporter("controller").report("result", cycles=3, kernel=2724810705, seed_used=False)
    assert capsys.readouterr().out == "controller: cycles 3, no random numbers drawn\n"
