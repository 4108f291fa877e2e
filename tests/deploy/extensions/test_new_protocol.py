"""A drive protocol of a package: a loop closes over it."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

pytestmark = pytest.mark.usefixtures("example_package")
OVER_TOY = ["link.can.interface=virtual", "link.can.protocol=toy", "duration_s=0.2"]


def test_loop_closes_over_it() -> None:
    run = simulate(load_setup("paper_arm_can", OVER_TOY)).data()
    summary = summarise(run)
    assert run.faults() == []
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    frames = summary["transport"]["can"]["frames_by_identifier"]
    assert frames["010"] == frames["101"] == frames["203"] == 100
    in_process = simulate(load_setup("paper_arm_can", [*OVER_TOY, "link.kind=in_process"])).data()
    np.testing.assert_allclose(run.true_errors_rad, in_process.true_errors_rad, atol=1e-5)


@pytest.mark.parametrize("kind", ["in_process", "zenoh"])
def test_settings_are_checked_on_other_links_too(kind: str) -> None:
    with pytest.raises(ScenarioError, match=r"link\.can\.settings\.sample: unknown key"):
        load_setup("paper_arm_can", [*OVER_TOY, f"link.kind={kind}", "link.can.settings.sample=32"])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("link.can.settings={sample: 32}", r"settings\.sample: unknown key"),
        (
            "link.can.settings.sample_identifier=0",
            r"sample_identifier = 0: must be greater than or equal to 1",
        ),
        ("link.can.node_ids=[1, 2, 10]", r"node_ids = \[1, 2, 10\]: must be at most 9 with Toy"),
        ("rate_hz=2000", r"takes sample \+ 3 × \(state 8 bytes \+ torque 4 bytes\) = up to"),
        (
            "link.can.protocol=semaphore",
            r"'semaphore': must be 'cia402', 'cansimple', 'mit', 'damiao', 'moteus' or 'toy'",
        ),
    ],
)
def test_scenario_that_does_not_fit_it_is_refused(override: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        load_setup("paper_arm_can", [*OVER_TOY, override])


def test_protocol_and_drive_read_the_settings_of_their_own() -> None:
    run = simulate(
        load_setup("paper_arm_can", [*OVER_TOY, "link.can.settings.sample_identifier=32"])
    )
    frames = summarise(run.data())["transport"]["can"]["frames_by_identifier"]
    assert frames["020"] == frames["101"] == 100
    assert "010" not in frames


@pytest.mark.parametrize("kind", ["can", "in_process", "zenoh"])
def test_shipped_protocols_refuse_such_settings(kind: str) -> None:
    over_mit = ["link.can.interface=virtual", "link.can.protocol=mit", "link.can.settings={a: 1}"]
    over_mit.append(f"link.kind={kind}")
    with pytest.raises(ScenarioError, match=r"link\.can\.settings = .* left out with MIT"):
        load_setup("paper_arm_can", over_mit)
