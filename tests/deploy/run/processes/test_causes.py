"""The order of failures: causes before their consequences."""

from __future__ import annotations

from deploy.run.processes.child import Failure, in_causal_order


def test_own_failure_comes_before_the_silence_that_it_causes() -> None:
    silence = Failure("the plant failed: no answer", role="plant", awaited="controller")
    failure = Failure("the controller failed: division by zero", role="controller")
    assert in_causal_order([silence, failure]) == [failure, silence]


def test_silence_of_a_process_that_has_not_failed_keeps_its_place() -> None:
    silence = Failure("the plant failed: no answer", role="plant", awaited="controller")
    killed = Failure("the relay was killed")
    assert in_causal_order([silence, killed]) == [silence, killed]
