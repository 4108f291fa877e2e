"""Rows of predicted torques bridge lost commands: whole runs, in virtual time."""

import numpy as np
import pytest

from bus_schema.messages import topics
from bus_schema.recording.mcap_log import read_log
from deploy.judge.metrics import summarise
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
BRIDGE = "controller.delay_compensation.bridge_ms"
DRIVES = ("controller.drive_feedback.enabled=true", "plant.drive_feedback.enabled=true")


def run(*overrides, duration_s=1.2, arm="paper_arm"):
    delays = ("link.uplink.delay_ms=8", "link.downlink.delay_ms=8")
    law = "controller.law=fixed_time_adaptive"
    settings = [f"duration_s={duration_s}", ON, law, *delays, *overrides]
    return simulate(load_setup(arm, settings))


def outage(at_s, for_ms):
    entry = f"{{kind: outage, at_s: {at_s}, for_s: {1e-3 * for_ms}}}"
    return f"link.downlink.schedule=[{entry}]"


def truth(of_run, name):
    return of_run.data().tables["plant_truth"][name]


def largest_error(of_run, from_s):
    """Largest error of a joint from then on, rad."""
    data = of_run.data()
    errors = np.abs(data.true_errors_rad[data.times_s(topics.PLANT_TRUTH) >= from_s])
    return float(errors.max())


@pytest.mark.parametrize("drives", [(), DRIVES])
def test_without_losses_a_bridge_changes_no_bit_of_the_motion(drives):
    """The next command acts at the instant of the second row, and replaces it.

    With an identified lag of the actuators, the prediction looks beyond the newest command.
    """
    no_lag = "controller.delay_compensation.identify_model=false"
    plain, bridged = (run(f"{BRIDGE}={ms}", no_lag, *drives, duration_s=0.3) for ms in (0, 50))
    for name in ("position", "velocity", "torque"):
        assert truth(bridged, name).tobytes() == truth(plain, name).tobytes()


def test_an_outage_is_survived_on_the_prediction():
    """For 190 ms no command arrives, while the UR5e moves along sinusoids at up to 0.6 rad/s.

    Under the last torque it deviates by 2.6 mrad: that torque carries it where it was. Its friction
    and inertia are identified, so the predicted torques leave 0.5 mrad. Both were 3.3 and 0.04 mrad
    with dry friction of 3 % alone: now it has that of a UR10e.
    """
    lost = outage(1.5, 190)
    settings = {"arm": "ur5e_motors", "duration_s": 1.9}
    held, bridged = (largest_error(run(f"{BRIDGE}={ms}", lost, **settings), 1.5) for ms in (0, 200))
    assert held > 2e-3
    assert bridged < 6e-4


def test_targets_of_drive_loops_go_on_along_the_reference():
    """Held targets move on at their velocity, 1.1 mrad wide of a curve after 190 ms."""
    lost = (outage(0.8, 190), *DRIVES)
    held, bridged = (largest_error(run(f"{BRIDGE}={ms}", *lost), 0.8) for ms in (0, 200))
    assert held > 8e-4
    assert bridged < 4e-4


def test_replay_of_a_bridged_run_is_identical_and_its_first_rows_are_judged(tmp_path):
    recorded = run(f"{BRIDGE}=20", outage(0.2, 15), duration_s=0.3)
    recorded.write_log(tmp_path / "run.mcap")
    assert replay(recorded.setup, read_log(tmp_path / "run.mcap")).is_identical
    data = recorded.data()
    commands = data.tables["joint_commands"]
    assert commands["effort"].shape == (len(commands), 3)
    assert len(commands) > 280
    assert summarise(data)["transport"]["downlink"]["lost"] == 15
