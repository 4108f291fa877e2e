"""The extra `all` has every optional feature that needs no compiler."""

from __future__ import annotations

import tomllib

from packaging.requirements import Requirement

from tests.warm_process import ROOT

NO_FEATURES = {"all", "bench", "bullet", "dev", "docs"}


def test_all_has_each_optional_feature():
    text = (ROOT / "pyproject.toml").read_text()
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    (one,) = extras["all"]
    assert Requirement(one).extras == set(extras) - NO_FEATURES
