"""Why a run left its funnel: a run with each cause, and one without it."""

from dataclasses import replace

import numpy as np
import pytest

from controller.control_law import Diagnostics
from deploy.judge.findings.lag import lag_s
from deploy.judge.findings.loss_reason import LossReason, Reason, loss_reason
from deploy.judge.findings.remedies import remedy_of
from deploy.judge.metrics import summarise
from deploy.judge.run_data import ROBOT_SERVER
from deploy.reports.studies.study_texts import reason_sentences
from deploy.reports.verdict_texts import loss_words
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from tests.one_joint import pd_setup, policy_setup, write_arm

ON = "controller.delay_compensation.enabled=true"
INERTIA_KG_M2 = 0.5


def loss_of(setup):
    return summarise(simulate(setup).data())["loss"]


def loss(*overrides, arm="paper_arm", duration_s=0.5):
    return loss_of(load_setup(arm, [f"duration_s={duration_s}", *overrides]))


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ((), None),
        # The arm may be held for 122.7 ms.
        ((ON, "link.uplink.delay_ms=140"), "start"),
        (("link.uplink.delay_ms=8", "controller.law=fixed_time_neural"), "growing"),
        # No command arrives from 0.1 s to 0.3 s: the arm goes on with the last torque.
        (("link.downlink.schedule=[{kind: outage, at_s: 0.1, for_s: 0.2}]",), "late command"),
        (("plant.actuator.saturation_nm=[30, 60, 20]",), "saturated"),
        (("plant.friction.coulomb_nm=150", "controller.law=pid"), "friction or model"),
    ],
)
def test_a_loss_has_a_reason(overrides, reason):
    found = loss(*overrides)
    assert (found and found["reason"]) == reason


@pytest.mark.parametrize(
    ("overrides", "reason", "words"),
    [
        # Both keep their bounds over shorter delays. The first command acts after 95 ms.
        ((ON, "link.uplink.delay_ms=95", "controller.law=smc"), "delay",
         "sooner than the law could act, over a delay of 95 ms"),
        (("link.uplink.delay_ms=20", "controller.law=pid"), "delay",
         "sooner than the law could act, over a delay of 20 ms"),
        (("link.uplink.delay_ms=14", "controller.law=pid"), "delay or model",
         "slowly, as by friction or an error of the model over a delay of 14 ms"),
        (("link.uplink.delay_ms=10", "plant.friction.coulomb_nm=150", "controller.law=pid"),
         "friction or model", "slowly, as by friction or an error of the model"),
    ],
)  # fmt: skip
def test_a_slow_loss_names_its_delay_where_the_error_arose_within_it(overrides, reason, words):
    found = loss(*overrides)
    assert (found["reason"], loss_words(LossReason(**found))) == (reason, words)


def test_nothing_is_known_to_make_up_for_the_lag_of_a_robot_that_a_client_moves():
    """A lag of 138 ms. A law that reads the reference 138 ms ahead would make up for it."""
    words = (
        "plant.interface.kind=servoj", "controller.law=streaming", "robot.initial_offset_rad=0",
        "duration_s=1",
    )  # fmt: skip
    late = simulate(load_setup("ur5e_motors", [*words, "controller.preview_ms=0"])).data()
    ahead = replace(late, setup=load_setup("ur5e_motors", words))
    assert loss_reason(ahead).reason == "lag"
    found = loss_reason(replace(ahead, link=ROBOT_SERVER))
    assert (found.reason, found.own_lag_ms) == ("robot's lag", pytest.approx(138.0, abs=1.0))


def test_a_joint_too_weak_for_a_payload_is_saturated_not_slow():
    """15 kg on a shoulder of 150 N m: at its limit from 2.0 s on, lost 0.14 s later."""
    links = ("link.uplink.delay_ms=10", "link.downlink.delay_ms=10")
    found = loss(ON, *links, "plant.payload_kg=15", arm="ur5e_motors", duration_s=2.3)
    assert (found["reason"], found["joint"]) == ("saturated", "shoulder_lift_joint")
    assert found["time_s"] == pytest.approx(2.138, abs=0.02)


def test_a_loss_after_a_reflex_names_the_reflex():
    """An initial error steps the torque by 1.59 N m in the second cycle; 1 N m is allowed."""
    words = ("plant.interface.kind=franka_torque", "controller.law=pid_gravity")
    found = loss(*words, arm="panda", duration_s=1.5)
    assert found["reason"] == "reflex"
    assert found["fault"] == "controller_torque_discontinuity at 0.002 s"


@pytest.mark.parametrize("law", ["streaming", "position_correction"])
def test_targets_that_arrive_in_bunches_are_jitter_and_no_unstable_loop(tmp_path, law):
    """Those of each 90 ms arrive together; a robot that follows them at once steps. A play-out
    of 95 ms evens that out."""
    rows = (f"{1e-3 * k:.3f},{90 - k % 90}" for k in range(4000))
    (tmp_path / "t.csv").write_text("\n".join(["time_s,delay_ms", *rows]))
    words = (
        "plant.interface.kind=rsi", f"controller.law={law}", "robot.initial_offset_rad=0",
        f"link.downlink={{trace: {{file: {tmp_path / 't.csv'}}}}}",
    )  # fmt: skip
    found = loss(*words, arm="ur5e_motors", duration_s=2.0)
    assert found["reason"] == "jitter"
    assert "link.playout_ms" in remedy_of(found["reason"], law)
    assert loss(*words, "link.playout_ms=95", arm="ur5e_motors", duration_s=2.0) is None


def test_swings_that_do_not_grow_are_an_oscillation():
    """At 21.5 ms this switching law keeps its bounds."""
    found = loss("link.uplink.delay_ms=22", "controller.law=smc", duration_s=11)
    assert found["reason"] == "oscillation"
    assert 5.0 < found["frequency_hz"] < 15.0


def test_a_study_explains_each_reason_in_one_clause():
    said = reason_sentences(["growing", "growing", "of an older version"])
    assert said == ["Lost by growing: an error left its bounds as an oscillation grew."]


@pytest.mark.parametrize("error", [np.nan, np.inf])
def test_positions_that_are_no_numbers_are_a_loss_with_a_reason(error):
    setup = load_setup("paper_arm", ["duration_s=0.5", "link.uplink.delay_ms=8"])
    data = simulate(setup).data()
    truth = data.tables["plant_truth"].copy()
    truth["position"][100:] = error
    found = loss_reason(replace(data, tables={**data.tables, "plant_truth": truth}))
    assert found.time_s == pytest.approx(0.1)
    assert found == LossReason(reason=Reason.SLOW, joint="base_yaw", time_s=found.time_s)


def test_the_frequency_is_that_of_the_oscillation():
    """A loop with a delay of 8 ms oscillates with some four delays as its period."""
    found = loss("link.uplink.delay_ms=8", "controller.law=fixed_time_neural")
    assert 20.0 < found["frequency_hz"] < 40.0
    assert found["joint"] == "elbow"


@pytest.mark.parametrize(
    ("stiffness", "damping"),
    [
        (-50.0, 0.0),  # the sign is wrong
        (-50.0, 5.0),  # that of the stiffness alone
        (50.0, -1.0),  # that of the damping, which swings
    ],
)
def test_a_wrong_sign_is_unstable_with_the_pole_of_the_loop(tmp_path, stiffness, damping):
    """J s² + D s + K = 0, as exact as a torque held for a millisecond is continuous."""
    setup = pd_setup(tmp_path, INERTIA_KG_M2, stiffness, damping, offset_rad=1e-3)
    found = loss_of(setup)
    pole = max(np.roots([INERTIA_KG_M2, damping, stiffness]).astype(complex), key=np.real)
    assert (found["reason"], found["without_delay"]) == ("unstable", True)
    assert found["rate_per_s"] == pytest.approx(pole.real, rel=0.02)
    assert found["frequency_hz"] == (
        pytest.approx(abs(pole.imag) / (2.0 * np.pi), rel=0.01) if pole.imag else None
    )
    assert "even without a delay" in loss_words(LossReason(**found))
    assert theory_of(setup)["unstable_without_delay"]["rate_per_s"] == pytest.approx(
        found["rate_per_s"], rel=0.02
    )


class OneWrongSign:
    """Exact linearisation with both poles at -5/s, but for one joint with the wrong sign."""

    def __init__(self, model, joint=0):
        self.diagnostics, self._model = Diagnostics(model.joints), model
        self._signs = np.where(np.arange(model.joints) == joint, -1.0, 1.0)

    def reset(self):
        pass

    def torque(self, tracking):
        wanted = -25.0 * tracking.error - 10.0 * tracking.error_rate
        acceleration = tracking.reference_acceleration + self._signs * wanted
        return self._model.inverse_dynamics(tracking.position, tracking.velocity, acceleration)


@pytest.mark.parametrize("joint", [1, 2])
def test_one_wrong_sign_of_an_arm_is_unstable_at_its_joint(joint):
    """s² = 10 s + 25 of that joint alone."""
    law = ("controller.law=tests.deploy.judge.test_loss_reason:OneWrongSign",
           f"controller.gains.custom.joint={joint}")  # fmt: skip
    frictionless = [f"plant.friction.{name}=0" for name in ("coulomb_nm", "viscous_nm_s")]
    found = loss(*law, *frictionless, arm="panda")
    assert (found["reason"], found["joint"]) == ("unstable", f"panda_joint{joint + 1}")
    assert found["rate_per_s"] == pytest.approx(5.0 + 50.0**0.5, rel=0.1)
    assert found["frequency_hz"] is None


def test_a_delay_makes_a_loop_swing_that_is_stable_without_it(tmp_path):
    """K = 200, D = 8: its phase margin at 20.9 rad/s lasts for 33 ms."""
    late = pd_setup(tmp_path, INERTIA_KG_M2, 200.0, 8.0, "link.uplink.delay_ms=60", offset_rad=0.01)
    found = loss_of(late)
    assert (found["reason"], found["without_delay"]) == ("growing", False)
    assert "without a delay" not in loss_words(LossReason(**found))
    assert loss_of(pd_setup(tmp_path, INERTIA_KG_M2, 200.0, 8.0, offset_rad=0.01)) is None


def test_slow_growth_is_not_called_friction(tmp_path):
    """K = 2, D = 4 with 1.5 s of delay: swings of some seconds, of which a run has few."""
    setup = pd_setup(
        tmp_path, INERTIA_KG_M2, 2.0, 4.0, "link.uplink.delay_ms=500", "duration_s=12",
        offset_rad=0.01,
    )  # fmt: skip
    found = loss_of(setup)
    assert found["reason"] == "growing"
    assert found["frequency_hz"] < 2.0


def test_a_transport_delay_is_a_lag_of_its_length(tmp_path):
    """A drive loop with both poles at -100/s is 2/100 s behind, and the delay more."""
    found = loss_of(policy_setup(tmp_path, "link.downlink.delay_ms=80"))
    assert found["reason"] == "lag"
    assert found["lag_ms"] == pytest.approx(80.0 + 20.0, rel=0.05)
    assert loss_words(LossReason(**found)) == (
        f"{found['lag_ms']:.0f} ms behind the reference, in proportion to its speed"
    )
    assert loss_of(policy_setup(tmp_path)) is None


TIMES_S = np.arange(1000) * 1e-3
NO_LAGS = {
    "ahead": lambda v, t: 0.05 * v,
    "offset": lambda v, t: 0.05 + 0.0 * t,
    "acceleration": lambda v, t: -0.05 * np.gradient(v, t),
    "growth": lambda v, t: 1e-3 * np.exp(8.0 * t),
    "lag longer than the time": lambda v, t: -0.6 * v,
}


@pytest.mark.parametrize("name", NO_LAGS)
def test_other_errors_are_no_lag(name):
    wanted, speeds = -0.5 * np.cos(2.0 * TIMES_S), np.sin(2.0 * TIMES_S)
    assert lag_s(NO_LAGS[name](speeds, TIMES_S), wanted, 1e-3) is None
    assert lag_s(-0.05 * speeds, wanted, 1e-3) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize("duration_s", [0.3, 1.0, 3.0])
def test_a_first_order_lag_is_its_time_constant_at_constant_speed(duration_s):
    """τ ẏ + y = v t follows y = v (t - τ) + v τ e^(-t/τ): e = -v τ once that has decayed."""
    tau_s, speed, period_s = 0.04, 0.7, 1e-3
    times_s = np.arange(round(duration_s / period_s) + 1) * period_s
    errors = -speed * tau_s * (1.0 - np.exp(-times_s / tau_s))
    late_s = lag_s(errors[-250:], speed * times_s, period_s)
    assert late_s == pytest.approx(tau_s, rel=0.1 if duration_s < 1.0 else 1e-6)


@pytest.mark.parametrize("late_s", [0.02, 0.0507, 0.11])
def test_an_arm_that_has_just_started_late_has_its_delay_as_lag(late_s):
    """The error of a delay at a start with a speed rises first, with the speed alone."""
    times_s = np.arange(301) * 1e-3
    late = -np.cos(np.maximum(times_s - late_s + 0.5, 0.5)) + np.cos(times_s + 0.5)
    assert lag_s(late, -np.cos(times_s + 0.5), 1e-3) == pytest.approx(late_s, rel=1e-3)
    at_rest = -np.cos(0.5) + np.cos(times_s + 0.5)
    assert lag_s(at_rest, -np.cos(times_s + 0.5), 1e-3) is None  # it never moved


SERVOJ = ("plant.interface.kind=servoj", "robot.initial_offset_rad=0")


@pytest.mark.parametrize(("gain", "lookahead_s"), [(300, 0.1), (800, 0.2)])
@pytest.mark.parametrize("arm", ["paper_arm", "ur5e_motors"])
def test_the_lag_of_a_position_interface_is_no_friction(arm, gain, lookahead_s):
    """It is behind by 4 ms, two thirds of the lookahead, its growth 200/gain, and half a cycle."""
    settings = (f"plant.interface.servoj.gain={gain}",
                f"plant.interface.servoj.lookahead_time_s={lookahead_s}")  # fmt: skip
    streaming = (*SERVOJ, *settings, "controller.law=streaming")
    found = loss(*streaming, "controller.preview_ms=0", arm=arm, duration_s=1.0)
    own_ms = 4.0 + 1e3 * lookahead_s * (2.0 / 3.0 + 200.0 / gain) + 1.0
    assert (found["reason"], found["without_delay"]) == ("robot's lag", False)
    assert found["own_lag_ms"] == pytest.approx(own_ms)
    assert 0.6 * own_ms < found["lag_ms"] < 1.05 * own_ms  # as it starts, less than at the end
    assert loss_words(LossReason(**found)) == f"by the robot's own lag of {own_ms:.0f} ms"
    assert "controller.preview_ms" in remedy_of(found["reason"], "streaming")
    assert loss(*streaming, arm=arm, duration_s=1.0) is None  # which reads ahead


@pytest.mark.parametrize("arm", ["paper_arm", "ur5e_motors"])
def test_an_initial_offset_does_not_hide_the_lag_of_the_robot(arm):
    """The arm comes from its offset, so that its error is no constant time at first."""
    streaming = ("plant.interface.kind=servoj", "controller.law=streaming")
    links = ("link.uplink.delay_ms=20", "link.downlink.delay_ms=20")
    found = loss(*streaming, *links, "controller.preview_ms=0", arm=arm, duration_s=1.0)
    assert (found["reason"], found["lag_ms"]) == ("robot's lag", None)
    assert found["own_lag_ms"] == pytest.approx(4.0 + 100.0 * (2.0 / 3.0 + 200.0 / 300.0) + 1.0)
    assert loss(*streaming, *links, arm=arm, duration_s=1.0) is None


@pytest.mark.parametrize("law", ["computed_torque", "fixed_time_adaptive"])
def test_a_law_of_torques_is_lost_by_the_lag_of_the_robot_it_drives(law):
    found = loss(*SERVOJ, f"controller.law={law}")
    assert (found["reason"], found["without_delay"]) == ("robot's lag", False)
    assert "position_correction" in remedy_of(found["reason"], law)
    quick = "plant.interface.servoj={dead_time_ms: 0, lag_ms: 0}"
    held = loss(*SERVOJ, quick, f"controller.law={law}")
    assert held is None or held["reason"] != "robot's lag"


OUTAGE = "link.downlink.schedule=[{{kind: outage, at_s: {}, for_s: {}}}]"


@pytest.mark.parametrize(("law", "preview_ms", "outage", "reason"), [
    ("streaming", 0, (0.3, 0.18), "robot's lag"),  # 138 ms, which alone leave the bounds
    ("streaming", 133, (0.3, 0.5), "late command"),  # of which 5 ms are left
    ("computed_torque", "auto", (0.1, 0.1), "robot's lag"),
])  # fmt: skip
def test_a_late_command_does_not_hide_the_lag_of_the_robot(law, preview_ms, outage, reason):
    words = (f"controller.law={law}", f"controller.preview_ms={preview_ms}")
    words = (*words, "plant.command_timeout_ms=1000")
    found = loss(SERVOJ[0], *words, OUTAGE.format(*outage), duration_s=1.5)
    assert found["reason"] == reason


SAG_RAD = 1.0 * 9.81 * 0.3 / 100.0


@pytest.mark.parametrize(("law", "funnel_rad", "reason"), [
    ("pid", 0.97 * SAG_RAD, "no gravity term"),
    ("pid", 1.03 * SAG_RAD, None),
    ("pid_gravity", 0.05 * SAG_RAD, None),
])  # fmt: skip
def test_a_law_without_gravity_sags_by_weight_over_stiffness(tmp_path, law, funnel_rad, reason):
    """1 kg at 0.3 m and 100 N m/rad, critically damped: m g l / K."""
    (tmp_path / "level").mkdir()
    write_arm(tmp_path / "level", INERTIA_KG_M2, lever_m=0.3, axis="0 1 0")
    gains = {"proportional": 100.0, "integral": 0.0, "derivative": 2.0 * (100.0 * 0.5) ** 0.5}
    setup = pd_setup(
        tmp_path, INERTIA_KG_M2, 0.0, 0.0, funnel_rad=funnel_rad,
        robot={"urdf": "level/arm.urdf", "initial_offset_rad": 0.0},
        controller={"law": law, "gains": {law: gains}},
    )  # fmt: skip
    found = loss_of(setup)
    assert (found and found["reason"]) == reason
    assert remedy_of("no gravity term", "pid") == "compare pid_gravity, which has a gravity term"
    assert remedy_of("no gravity term", "smc") is None


def test_a_small_payload_leaves_the_lack_of_a_gravity_term_the_reason():
    words = ("controller.law=pid", "controller.gains.pid.integral=0", "plant.payload_kg=1")
    assert loss(*words, duration_s=1.0)["reason"] == "no gravity term"


RAMP = "link.uplink.schedule=[{kind: ramp, at_s: 0.3, for_s: 2.5, delay_ms: 200}]"
DEAD = "faults=[{kind: actuator_dead, joint: elbow, at_s: 0.05}]"


@pytest.mark.parametrize(("arm", "words", "not_blamed"), [
    # The reference is read ahead by all of the robot's lag: what is left is the network's.
    ("paper_arm", (*SERVOJ, "controller.law=streaming", RAMP), "robot's lag"),
    ("paper_arm", (*SERVOJ, "controller.law=computed_torque", DEAD), "robot's lag"),
    ("paper_arm", ("controller.law=pid", "robot.initial_offset_rad=0", DEAD), "no gravity term"),
    # The payload is too heavy for any law, and heavier than what a gravity term knows.
    ("paper_arm", ("controller.law=pid", "plant.payload_kg=100"), "no gravity term"),
    # A reflex stops the robot at 2 ms.
    ("panda", ("controller.law=pid", "plant.interface.kind=franka_position"), "no gravity term"),
])  # fmt: skip
def test_no_law_or_robot_is_blamed_for_a_network_a_fault_or_a_stop(arm, words, not_blamed):
    found = loss(*words, arm=arm, duration_s=2.5)
    assert found["reason"] != not_blamed


def test_a_law_that_is_compared_already_is_no_advice():
    said = remedy_of("no gravity term", "pid", ["pid", "pid_gravity"])
    assert said == "it has no gravity term, which pid_gravity has"


def test_a_chunk_that_ran_out_has_nothing_left_to_send(tmp_path):
    """It is asked every 200 ms: 40 rows are too few, 300 are not."""
    found = loss_of(policy_setup(tmp_path, rows=40, every=200))
    assert found["reason"] == "chunk ran out"
    assert found["frequency_hz"] is None
    assert loss_words(LossReason(**found)) == "with nothing left to send"
    assert loss_of(policy_setup(tmp_path, rows=300, every=200)) is None


def test_an_answer_that_comes_much_later_than_usual_is_the_reason(tmp_path):
    """The first inference in motion takes 0.6 s, others 20 ms: the reference leaves in 0.45 s."""
    slow = ("controller.inference_ms=20", "controller.first_inference_ms=600")
    found = loss_of(policy_setup(tmp_path, *slow))
    assert found["reason"] == "old answer"
    assert 0.4 < found["time_s"] < 0.6


def test_rows_that_ran_out_and_are_held_on_purpose_are_no_reason(tmp_path):
    """One row is held until the next answer: the arm lags, as it is asked every 200 ms."""
    found = loss_of(policy_setup(tmp_path, rows=1, every=200))
    assert found["reason"] != "chunk ran out"
