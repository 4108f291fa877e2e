"""The table of kinds of results."""

from __future__ import annotations

import pytest

from deploy.reports.kinds import kind_named

STUDIES = {"comparison", "sweep", "margin", "robustness", "tune"}
JUDGED_AGAIN = {"comparison", "diff", "datasheet"}
WITH_PAGE = {"sweep", "margin", "robustness", "tune"}


@pytest.mark.parametrize("name", sorted(STUDIES | JUDGED_AGAIN | {"run", "identify"}))
def test_what_a_kind_names_can_be_imported(name: str) -> None:
    kind = kind_named(name)
    assert (kind.study.kind if kind.study else None) == (name if name in STUDIES else None)
    assert (kind.again is not None) == (name in JUDGED_AGAIN)
    assert (kind.page is not None) == (name in WITH_PAGE)
