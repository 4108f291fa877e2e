"""Values and shares of studies as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence

from deploy.judge.findings.loss_reason import Reason
from deploy.judge.findings.remedies import remedy_of
from deploy.reports.studies.case_result import Case, CaseResult, CasesResult
from deploy.reports.studies.study_result import Runs, Share
from deploy.reports.tables import ABSENT, Column


def ceiling_text(case: CaseResult) -> str | None:
    """The held-arm ceiling of a case, as far as there is one."""
    ceiling = case.held_arm_ceiling_ms
    return None if ceiling is None else f"{ceiling:.0f} ms"


def value_text(value: float, result: CasesResult[Case]) -> str:
    """A value with its unit."""
    return f"{value:g} {result.unit}".rstrip()


def value_title(result: CasesResult[Case]) -> str:
    """Return the name of the growing quantity, with its unit."""
    return Column(result.title, result.unit or "").title


def interval_text(share: Share) -> str:
    """The 95 % interval of a share in per cent: Wilson's, or that of a sequential test."""
    if share.interval is None:
        return ABSENT
    low, high = (100 * end for end in share.interval)
    return f"{low:.0f}–{high:.0f} %"


def share_text(share: Share) -> str:
    """Return the number kept of the number judged."""
    return f"{share.kept} of {share.total}" if share.total else ABSENT


def listed(names: Sequence[str]) -> str:
    """Return names as in a sentence."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def number_of(count: int, what: str) -> str:
    """Return how many there are, as in a sentence: one start, 3 starts."""
    return f"one {what}" if count == 1 else f"{count} {what}s"


def losses_text(runs: Runs) -> str:
    """Explain why runs left their funnel, the most frequent reason first, with their joint."""
    losses, joints = Counter(runs.losses), Counter(runs.loss_joints)
    return ", ".join(name for name, _ in (*losses.most_common(), *joints.most_common(1)))


def reason_sentences(names: Iterable[str]) -> list[str]:
    """Explain each of these reasons of losses in one clause; names of older versions are left out.

    Args:
        names: values of `Reason`.
    """
    known = {each.value: each.words for each in Reason}
    return [
        f"Lost by {name}: an error left its bounds {known[name]}."
        for name in dict.fromkeys(names)
        if name in known
    ]


def remedy_text(losses: Mapping[str, int], law: str, compared: Collection[str] = ()) -> str | None:
    """Return what helps a law after the most frequent of its losses; None where nothing is known.

    Args:
        losses: number of runs by the reason why they were lost.
        law: name of the law.
        compared: laws beside it.
    """
    reasons = (reason for reason, _ in Counter(losses).most_common(1))
    return next((remedy_of(reason, law, compared) for reason in reasons), None)
