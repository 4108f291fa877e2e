"""The kind of study `policy`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.policy.page import policy_page
from deploy.studies.policy.policy import PolicyStudy
from deploy.studies.policy.result import PolicyResult

KIND = ResultKind(PolicyStudy.kind, PolicyResult, PolicyStudy, policy_page)
