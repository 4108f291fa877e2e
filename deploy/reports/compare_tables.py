"""The numbers of a comparison: the verdict in words, and tables with a row for each law."""

from __future__ import annotations

from collections.abc import Sequence

from deploy.comparison.comparison import Comparison, LawRun
from deploy.reports.tables import number, of_joint, percent, table
from deploy.reports.verdict import Verdict

_SHOWN_FAULTS = 2
_NAMED_JOINTS = 2


def judge(comparison: Comparison) -> Verdict:
    """The verdict on a comparison."""
    runs = comparison.runs
    kept, faulted = ([r for r in runs if r.kept_bounds], [r for r in runs if not r.is_whole])
    reasons = [f"{run.law}: {bounds_sentence(run)}" for run in runs]
    reasons += _ranking(comparison)
    headline = f"{len(kept)} of {len(runs)} laws kept their bounds"
    if faulted:
        return Verdict("broken", f"{headline}, {len(faulted)} did not finish", reasons)
    if len(kept) == len(runs):
        return Verdict("good", f"All {len(runs)} laws kept their bounds", reasons)
    if not kept:
        return Verdict("bad", "No law kept its bounds", reasons)
    return Verdict("mixed", headline, reasons)


def bounds_sentence(run: LawRun) -> str:
    """What became of a law's bounds, or of the law."""
    bounds, faults = run.summary["bounds"], run.summary["faults"]
    if not run.is_whole:
        return "; ".join(faults[:_SHOWN_FAULTS]) or "did not come to its end"
    if bounds["kept"]:
        return f"kept its bounds, smallest margin {percent_of(bounds['margin_min'])}"
    return (
        f"left its bounds at {bounds['first_violation_s']:.3f} s, outside at"
        f" {percent_of(bounds['violation_fraction'])} of the ticks"
    )


def percent_of(value: float | None) -> str:
    """A fraction as per cent, to three digits."""
    return number(value, 100.0, " %")


def largest(values: Sequence[float | None] | None) -> float | None:
    """The largest of all joints; None if one of them has none."""
    if values is None:
        return None
    known = [value for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None


def verdict_table(comparison: Comparison) -> str:
    """A row per law with what decides; each number is that of the law's worst joint."""
    header = ["Law", "Bounds", "Ticks outside", "Smallest margin", "RMS error (mrad)",
              "Σ|Δτ| (N m/s)", "Torque energy above 50 Hz", "Settled after (s)",
              "Settling bound (s)", "Saturated ticks"]  # fmt: skip
    rows, ranked = [], {}
    for index, run in enumerate(comparison.runs):
        tracking, torque, bounds = (run.summary[s] for s in ("tracking", "torque", "bounds"))
        variation, settled = (
            largest(values)
            for values in (torque["total_variation_nm_per_s"], tracking["settling_time_s"])
        )
        rms, share = largest(tracking["rms_rad"]), largest(torque["share_above_50_hz"])
        rows.append([
            run.law, _status(run), percent(bounds["violation_fraction"]),
            percent_of(bounds["margin_min"]), number(rms, 1e3), number(variation),
            percent_of(share), number(settled), number(_settling_bound(run)),
            percent_of(torque["saturated_fraction"]),
        ])  # fmt: skip
        for column, value in ((4, rms), (5, variation), (6, share), (7, settled)):
            ranked[index, column] = value if run.is_whole else None
    return table(header, rows, "numbers", _best(ranked))


def joint_table(comparison: Comparison, section: str, key: str, factor: float = 1.0) -> str:
    """One number of the summaries, a row per law and a column per joint, the smallest set off."""
    names = comparison.runs[0].summary["tracking"]["joint_names"] if comparison.runs else []
    rows, ranked = [], {}
    for index, run in enumerate(comparison.runs):
        values = [of_joint(run.summary[section][key], joint) for joint in range(len(names))]
        rows.append([run.law, *(number(value, factor) for value in values)])
        for joint, value in enumerate(values):
            ranked[index, joint + 1] = value if run.is_whole else None
    return table(["Law", *names], rows, "numbers", _best(ranked))


def _status(run: LawRun) -> str:
    if not run.is_whole:
        return "fault"
    return "kept" if run.kept_bounds else "lost"


def _settling_bound(run: LawRun) -> float | None:
    bound = run.summary["tracking"]["settling_bound_s"]
    return largest(bound) if isinstance(bound, list) else bound


def _best(ranked: dict[tuple[int, int], float | None]) -> set[tuple[int, int]]:
    """Row and column of the smallest number of each column; none where nothing competes."""
    best = set()
    for column in {column for _, column in ranked}:
        cells = {cell: v for cell, v in ranked.items() if cell[1] == column and v is not None}
        if len(cells) > 1:
            best.add(min(cells, key=lambda cell: cells[cell]))
    return best


def _ranking(comparison: Comparison) -> list[str]:
    """Who is most precise, joint by joint, and who is smoothest."""
    whole = [run for run in comparison.runs if run.is_whole]
    sentences = []
    for what, section, key in (
        ("Smallest RMS error", "tracking", "rms_rad"),
        ("Least total variation of torque", "torque", "total_variation_nm_per_s"),
    ):
        competing = {run.law: run.summary[section][key] for run in whole}
        competing = {law: values for law, values in competing.items() if values is not None}
        if len(competing) > 1:
            sentences.append(f"{what}: {_winners(competing, whole)}.")
    return sentences


def _winners(competing: dict[str, list[float]], whole: list[LawRun]) -> str:
    """Who has the smallest number on which joints, and how much less than the next best."""
    names = whole[0].summary["tracking"]["joint_names"]
    won: dict[str, dict[str, float]] = {}
    for joint, name in enumerate(names):
        first, second = sorted(competing, key=lambda law: competing[law][joint])[:2]
        ratio = competing[first][joint] / max(competing[second][joint], 1e-300)
        won.setdefault(first, {})[name] = ratio
    return "; ".join(
        f"{law} on {_joints(list(ratios), len(names))},"
        f" at most {number(max(ratios.values()))} × the next best"
        for law, ratios in won.items()
    )


def _joints(some: list[str], joints: int) -> str:
    if len(some) == joints:
        return "every joint"
    if len(some) <= _NAMED_JOINTS:
        return " and ".join(some)
    return f"{len(some)} of {joints} joints"
