"""Fuzz of the guarantee: under one play-out time, all patterns of delays up to it act alike.

``python -m scripts.experiments.patterns_one_digest --patterns 2000`` draws patterns for each
setting: constant, periodic, random from tick to tick, bursts at the start, whole ticks, all of the
delay in one direction. It counts the digests of motion and commands. The exit code is 1 if a
setting has more than one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from bus_schema.messages import topics
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData, stamps_s
from deploy.run.simulate import simulate
from deploy.scenario.playout import EXPECTED
from deploy.scenario.scenario import load_setup

COMPENSATED = "controller.delay_compensation.enabled=true"
BRIDGE = "controller.delay_compensation.bridge_ms=50"
DRIVES = ("controller.drive_feedback.enabled=true", "plant.drive_feedback.enabled=true")
_MOVING_S = 0.15
"""Time that the arm moves at least: it is held until the first command acts."""
_SHAPES = ("square", "sawtooth", "falling", "random", "walk")


class Setting(NamedTuple):
    """One arm under one play-out time, which all patterns share.

    Attributes:
        arm: name of a scenario.
        rate_hz: rate of the loop.
        substeps: physics steps per tick.
        playout_ms: d, the time from a state until the torque that answers it acts.
        what: law and equipment, in words.
        overrides: other values of the scenario, with those that set d.
    """

    arm: str
    rate_hz: float
    substeps: int
    playout_ms: float
    what: str
    overrides: tuple[str, ...]

    @property
    def tick_ns(self) -> int:
        return round(1e9 / self.rate_hz)

    @property
    def common(self) -> tuple[str, ...]:
        """All overrides but those of the link's delays."""
        duration_s = 1e-3 * self.playout_ms + max(_MOVING_S, 6e-9 * self.tick_ns)
        return (
            f"rate_hz={self.rate_hz:g}", f"plant.substeps={self.substeps}",
            f"duration_s={duration_s:.3f}", *self.overrides,
        )  # fmt: skip

    @property
    def cells(self) -> tuple[str, ...]:
        """The cells of its row of the table, as `COLUMNS`."""
        rate, steps, playout = f"{self.rate_hz:g}", f"{self.substeps}", f"{self.playout_ms:g}"
        return self.arm, self.what, rate, steps, playout


COLUMNS = ("arm", "what", "rate, Hz", "steps", "d, ms", "patterns", "digests")


def compensated(
    arm: str, rate_hz: float, substeps: int, expected_ms: float, what: str, *more: str
) -> Setting:
    """Return a setting of the adaptive law with compensation, whose commands say when they act."""
    law = "controller.law=fixed_time_adaptive"
    given = (COMPENSATED, f"{EXPECTED}={expected_ms:g}", law, *more)
    return Setting(arm, rate_hz, substeps, expected_ms, what, given)


SETTINGS = (
    compensated("paper_arm", 1000, 4, 111, "adaptive"),
    compensated("paper_arm", 50, 4, 111, "adaptive"),
    compensated("paper_arm", 2000, 1, 16, "neural", "controller.law=fixed_time_neural"),
    compensated("panda_motors", 250, 3, 48, "adaptive"),
    compensated("panda_motors", 500, 2, 37.3, "adaptive, drive loops", *DRIVES),
    compensated("iiwa", 1000, 2, 0.5, "adaptive"),
    compensated("ur5e_motors", 300, 7, 60, "adaptive, bridge", BRIDGE),
    Setting("paper_arm", 1000, 4, 16, "smc, fixed play-out, no compensation",
            ("controller.law=smc", "link.playout_ms=16")),
    Setting("iiwa", 1000, 1, 24, "neural, fixed play-out",
            (COMPENSATED, "controller.law=fixed_time_neural", "link.playout_ms=24")),
)  # fmt: skip


class Outcome(NamedTuple):
    """What a run under one pattern did.

    Attributes:
        setting: number of the setting.
        digest: of the motion, and of all commands that every pattern delivers.
        late: commands that came after their time; none below d.
        link: overrides of the pattern.
    """

    setting: int
    digest: str
    late: int
    link: tuple[str, ...]


def drawn(numbers: random.Random, setting: Setting, folder: Path) -> tuple[str, ...]:
    """Return the overrides of a pattern whose delays of both directions never exceed d.

    Args:
        numbers: where it is drawn from.
        setting: the setting.
        folder: for the files of traces.
    """
    largest_ns, tick_ns = round(1e6 * setting.playout_ms), setting.tick_ns
    ticks = largest_ns // tick_ns
    up_ns = numbers.choice([
        0, largest_ns, largest_ns // 2, ticks * tick_ns, numbers.randint(0, ticks) * tick_ns,
        numbers.randint(0, largest_ns),
    ])  # fmt: skip
    limits_ns = {"uplink": up_ns, "downlink": largest_ns - up_ns}
    return tuple(
        f"link.{name}={json.dumps(_direction(numbers, limit_ns, tick_ns, folder / name))}"
        for name, limit_ns in limits_ns.items()
    )


def _direction(numbers: random.Random, limit_ns: int, tick_ns: int, file: Path) -> dict[str, Any]:
    """Return the section of a direction; a trace is written to a file of this name."""
    kind = numbers.choice(["constant", "pattern", "bursts", "ticks"])
    if kind == "constant":
        return {"delay_ms": 1e-6 * numbers.choice([limit_ns, numbers.randint(0, limit_ns)])}
    if kind == "pattern":
        return {"delay_ms": 1e-6 * limit_ns, "pattern": _pattern(numbers, limit_ns)}
    delays_ns = (_bursts if kind == "bursts" else _ticks)(numbers, limit_ns, tick_ns)
    rows = [f"{1e-9 * at_ns:.9f},{1e-6 * delay_ns:.6f}" for at_ns, delay_ns in delays_ns]
    file.write_text("\n".join(["time_s,delay_ms", *rows, "60,0", ""]))
    return {"trace": {"file": str(file), "start_s": 0}}


def _pattern(numbers: random.Random, limit_ns: int) -> dict[str, Any]:
    shape = numbers.choice(_SHAPES)
    found = {
        "shape": shape, "period_ms": 0.5 * 600.0 ** numbers.random(),
        "phase_ms": numbers.uniform(0.0, 300.0), "least_ms": numbers.uniform(0.0, 1e-6 * limit_ns),
    }  # fmt: skip
    if shape == "square":
        found["duty"] = numbers.uniform(0.01, 0.99)
    return found if shape != "walk" else found | {"seed": numbers.randint(0, 9)}


def _bursts(numbers: random.Random, limit_ns: int, tick_ns: int) -> Iterator[tuple[int, int]]:
    """Return when the delay changes, and to which value: short bursts after the start."""
    low_ns = numbers.choice([0, numbers.randint(0, limit_ns)])
    at_ns = 0
    yield at_ns, numbers.choice([low_ns, limit_ns])
    for _ in range(numbers.randint(1, 4)):
        at_ns += numbers.randint(1, 12 * tick_ns)
        yield at_ns, limit_ns
        at_ns += numbers.randint(1, 6 * tick_ns)
        yield at_ns, low_ns


def _ticks(numbers: random.Random, limit_ns: int, tick_ns: int) -> Iterator[tuple[int, int]]:
    """Return a delay for each tick of half a second, of whole ticks or not."""
    is_whole = numbers.random() < 0.5
    for tick in range(500_000_000 // tick_ns):
        whole_ns = numbers.randint(0, limit_ns // tick_ns) * tick_ns
        yield tick * tick_ns, whole_ns if is_whole else numbers.randint(0, limit_ns)


def digest(run: RunData, playout_ms: float) -> str:
    """Return SHA-256 over the motion and the commands that answer states until d before the end."""
    commands, truth = (
        run.tables[each.name] for each in (topics.JOINT_COMMANDS, topics.PLANT_TRUTH)
    )
    period_s = 1e-9 * run.setup.grid.period_ns
    until_s = stamps_s(truth)[-1] - 1e-3 * playout_ms - 0.5 * period_s
    acted = commands[stamps_s(commands) < until_s]
    values = (acted[name].tobytes() for name in acted.dtype.names or ())
    return hashlib.sha256(b"".join([run.motion.encode(), *values])).hexdigest()


def tried(number: int) -> Outcome:
    """Run the pattern of this number, under one of the settings in turn."""
    at = number % len(SETTINGS)
    setting = SETTINGS[at]
    with tempfile.TemporaryDirectory() as folder:
        link = drawn(random.Random(number), setting, Path(folder))
        run = simulate(load_setup(setting.arm, [*setting.common, *link])).data()
    late = summarise(run)["transport"]["playout"]["late"]
    return Outcome(at, digest(run, setting.playout_ms), late, link)


def main(patterns: int, workers: int, first: int) -> int:
    """Count the digests of each setting; return the exit code."""
    counts: list[Counter[str]] = [Counter() for _ in SETTINGS]
    late, others = 0, dict[int, Outcome]()
    with ProcessPoolExecutor(workers) as executor:
        for outcome in executor.map(tried, range(first, first + patterns), chunksize=8):
            known = counts[outcome.setting]
            if known and outcome.digest not in known:
                others.setdefault(outcome.setting, outcome)
            known[outcome.digest] += 1
            late += outcome.late
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for setting, found in zip(SETTINGS, counts, strict=True):
        cells = (*setting.cells, str(found.total()), str(len(found)))
        print(f"| {' | '.join(cells)} |")
    print(f"{patterns} patterns, {late} late commands")
    for at, outcome in others.items():
        print(f"another digest: {', '.join(SETTINGS[at].cells)}: {' '.join(outcome.link)}")
    return int(bool(late or others))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patterns", type=int, default=2000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="number of the first pattern")
    given = parser.parse_args()
    logging.disable()
    sys.exit(main(given.patterns, given.workers, given.first))
