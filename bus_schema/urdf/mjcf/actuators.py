"""Effects of a compiled MJCF model's actuators at their joints.

An actuator has its joint's position and speed times the gear, and its joint the force times that.
So stiffness, damping and inertia have the gear squared at the joint.

Importing this module imports MuJoCo, so import it where it is used.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.mujoco_library import mujoco
from bus_schema.urdf.mjcf.joint_actuators import LEFT_OUT, JointActuators, Omissions

_DYNAMICS, _GAIN, _BIAS = mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias
_FILTERS = (_DYNAMICS.mjDYN_FILTER, _DYNAMICS.mjDYN_FILTEREXACT)
_POSITION, _VELOCITY, _FORCE, _VOLTAGE = (
    int(getattr(mujoco.mjtCtrlInput, f"mjINPUT_{name}")) for name in ("POS", "VEL", "FF", "VOLTAGE")
)
ONE_SIDED = "not symmetric; the larger end counts for both directions"


class Actuator:
    """An actuator of a compiled model on a hinge or slide.

    Args:
        model: the compiled model.
        number: its number.
        omitted: what is not carried over is noted there.

    Attributes:
        joint: number of its joint.
        has_input: whether it has a control; without one it is a passive device.
    """

    def __init__(self, model: Any, number: int, omitted: Omissions) -> None:
        self._omitted, own = omitted, model.actuator(number)
        self._name = f"actuator {own.name or number}"
        self.joint = int(model.actuator_trnid[number][0])
        self._gear = float(model.actuator_gear[model.actuator_outadr[number]][0])
        self._dynamics, self._gain, self._bias = (
            kind(int(getattr(model, f"actuator_{name}type")[number]))
            for name, kind in (("dyn", _DYNAMICS), ("gain", _GAIN), ("bias", _BIAS))
        )
        self._dynprm, self._gainprm, self._biasprm = (
            getattr(model, f"actuator_{name}prm")[number] for name in ("dyn", "gain", "bias")
        )
        self._inputs = int(model.actuator_ctrlspec[number])
        first, count = model.actuator_ctrladr[number], model.actuator_ctrlnum[number]
        self.has_input = count > 0
        self._controls: list[Vector | None] = [
            model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else None
            for i in range(first, first + count)
        ]
        limited = bool(model.actuator_forcelimited[number])
        self._forces: Vector | None = model.actuator_forcerange[number] if limited else None
        is_held = bool(model.actuator_actlimited[number])
        self._states: Vector | None = model.actuator_actrange[number] if is_held else None
        self._is_early = bool(model.actuator_actearly[number])
        self._model, self._number = model, number

    def add_to(self, drive: JointActuators) -> None:
        """Add what it does to the drive of its joint."""
        self._add_passive(drive)
        self._add_delay(drive)
        if self._gain == _GAIN.mjGAIN_DCMOTOR:
            self._add_dc_motor(drive)
        elif self._gain == _GAIN.mjGAIN_PID:
            self._add_pid(drive)
        elif self._gain == _GAIN.mjGAIN_FIXED or not self._gainprm[1:3].any():
            self._add_linear(drive)
        else:
            self._add_other(drive)

    def _omit(self, attribute: str, reason: str = LEFT_OUT) -> None:
        self._omitted.add(attribute, self._name, reason, self.joint)

    def _add_passive(self, drive: JointActuators) -> None:
        """Add inertia and damping, which no limit of force concerns."""
        model, number, squared = self._model, self._number, self._gear**2
        drive.rotor_inertia += float(model.actuator_armature[number]) * squared
        drive.viscous += float(model.actuator_damping[number]) * squared
        if model.actuator_dampingpoly[number].any():
            self._omit("quadratic and cubic damping")

    def _add_delay(self, drive: JointActuators) -> None:
        """Add the dead time of its controls, and the lag of its state."""
        model, number = self._model, self._number
        delay_s, (samples, order) = (
            float(model.actuator_delay[number]),
            model.actuator_history[number],
        )
        drive.delay = max(drive.delay, delay_s)
        if delay_s > (kept_s := samples * model.opt.timestep) * (1.0 + 1e-9):
            least = f"{1e3 * kept_s:g} ms that nsample × timestep keep"
            self._omit("delay", f"{1e3 * delay_s:g} ms, beyond the {least}")
        if delay_s and order:
            self._omit("interp", "commands are held between ticks here")
        if self._dynamics in _FILTERS:
            drive.lag = max(drive.lag, float(self._dynprm[0]))
            if self._bias == _BIAS.mjBIAS_AFFINE and self._biasprm[1:3].any():
                why = "it filters the target there, and the torque with the drive's own loop here"
                self._omit("timeconst", why)

    def _add_linear(self, drive: JointActuators) -> None:
        """Add gain · control + bias[0] + bias[1] · length + bias[2] · speed.

        A motor has a gain alone. A servo comes to rest where the force is zero.
        """
        gear, bias = self._gear, self._biasprm
        is_servo = self._bias == _BIAS.mjBIAS_AFFINE and bool(bias[1:3].any())
        if self._dynamics not in (_DYNAMICS.mjDYN_NONE, *_FILTERS, _DYNAMICS.mjDYN_INTEGRATOR):
            self._omit(f"dyntype {self._dynamics.name.removeprefix('mjDYN_').lower()}")
        elif self._dynamics == _DYNAMICS.mjDYN_INTEGRATOR:
            self._omit("dyntype integrator", "its control is a rate; a target, or a torque, here")
        if self._bias not in (_BIAS.mjBIAS_NONE, _BIAS.mjBIAS_AFFINE):
            self._omit(f"biastype {self._bias.name.removeprefix('mjBIAS_').lower()}")
        ends = self._ends()
        forces = None if ends is None else self._gainprm[0] * ends
        self._add_effort(drive, None if is_servo else forces)
        if self._bias == _BIAS.mjBIAS_AFFINE and bias[0]:
            self._omit("constant force (bias)")
        if not is_servo:
            return
        self._add_gains(drive, -bias[1], -bias[2])
        if gear and self._dynamics == _DYNAMICS.mjDYN_INTEGRATOR and self._controls[0] is not None:
            drive.limit_speed(self._controls[0] / gear)
        if forces is None or not gear:
            return
        if bias[1] < 0.0:
            drive.limit_range((forces + bias[0]) / (-bias[1] * gear))
        elif bias[2] < 0.0:
            drive.limit_speed((forces + bias[0]) / (bias[2] * gear))

    def _ends(self) -> Vector | None:
        """Return the ends of what the gain multiplies; None for no limit."""
        control = self._controls[0] if self._controls else None
        if self._dynamics == _DYNAMICS.mjDYN_NONE:
            return control
        if self._dynamics not in _FILTERS or control is None:
            return self._states
        if self._states is None:
            return control
        clipped: Vector = np.clip(control, *self._states)
        return clipped

    def _add_effort(self, drive: JointActuators, forces: Vector | None) -> None:
        """Add the largest force, of the limit and of the controls."""
        both = [each for each in (self._forces, forces) if each is not None]
        largest = min((float(abs(each).max()) for each in both), default=math.inf)
        drive.effort += abs(self._gear) * largest if self._gear else 0.0
        for name, ends in (("forcerange", self._forces), ("ctrlrange", forces)):
            if ends is not None and abs(ends.sum()) > 1e-9 * abs(ends).max():
                self._omit(name, ONE_SIDED)

    def _add_gains(self, drive: JointActuators, stiffness: float, damping: float) -> None:
        """Add the gains of a servo around its target."""
        for name, gain in (("stiffness", stiffness), ("damping", damping)):
            if gain < 0.0:
                self._omit(f"negative {name}")
        drive.stiffness += max(stiffness, 0.0) * self._gear**2
        drive.damping += max(damping, 0.0) * self._gear**2

    def _add_pid(self, drive: JointActuators) -> None:
        """Add a controller with targets of position and velocity, and a torque beside them."""
        bias, gear = self._biasprm, self._gear
        self._add_effort(drive, None)
        self._add_gains(drive, -bias[1], -bias[2])
        for name, value in (("ki", self._gainprm[0]), ("slewmax", self._dynprm[1])):
            if value:
                self._omit(name)
        if bias[1] and not self._inputs & _POSITION:
            self._omit("input", "without positions, it pulls to zero there; to the target here")
        ranges = iter(self._controls)
        for kind in (_POSITION, _VELOCITY, _FORCE):
            ends = next(ranges, None) if self._inputs & kind else None
            if ends is not None and kind == _FORCE:
                self._omit("ffrange", "torques beside the targets have the drive's limit here")
            elif ends is not None and kind == _POSITION and gear:
                drive.limit_range(ends / gear)
            elif ends is not None and gear:
                drive.limit_speed(ends / gear)

    def _add_dc_motor(self, drive: JointActuators) -> None:
        """Add a motor with its back-EMF: as a drive that controls its current, within a voltage.

        Without a control it is shorted, and brakes.
        """
        resistance, constant, _, _, stiffness, integral, damping, largest_v = self._gainprm[:8]
        gear = abs(self._gear)
        slope = constant**2 / resistance * gear**2
        self._add_gears(drive)
        if not self.has_input:
            drive.viscous += slope
            return
        if self._inputs & _VOLTAGE:
            controls = self._controls[-1]
            largest_v = 0.0 if controls is None else float(abs(controls).max())
            why = "its drive controls the current here, so back-EMF limits torque and damps nothing"
            self._omit("voltage input", why)
        self._add_gains(drive, stiffness, damping)
        most = math.inf if self._forces is None else float(abs(self._forces).max()) * gear
        if largest_v > 0.0 and constant > 0.0 and gear:
            stall, free = constant / resistance * largest_v * gear, largest_v / (constant * gear)
            most = min(most, stall)
            drive.stall, drive.no_load_speed = drive.stall + stall, free
            drive.velocity = min(drive.velocity, free)
        drive.effort += most
        drive.lag = max(drive.lag, float(self._dynprm[0]))
        for name, value in (
            ("thermal", self._dynprm[2]), ("saturation current_rate", self._dynprm[1]),
            ("controller ki", integral), ("controller slewmax", self._dynprm[7]),
        ):  # fmt: skip
            if value:
                self._omit(name)

    def _add_gears(self, drive: JointActuators) -> None:
        """Add cogging and friction of a motor."""
        amplitude, poles, phase, coulomb, static, speed = self._biasprm[:6]
        gear = abs(self._gear)
        if amplitude and gear:
            drive.cogging += abs(amplitude) * gear
            drive.cogging_periods = max(drive.cogging_periods, poles * gear)
            if phase:
                self._omit("cogging phase")
        if self._dynprm[5]:
            drive.coulomb += coulomb * gear
            drive.stribeck += max(static - coulomb, 0.0) * gear
            drive.stribeck_velocity = max(drive.stribeck_velocity, speed / gear if gear else 0.0)
            self._omit("lugre stiffness and damping", "its friction has no bristles here")

    def _add_other(self, drive: JointActuators) -> None:
        """Note an actuator whose force is no control times a gain; of it only a limit counts."""
        if self._gain == _GAIN.mjGAIN_AFFINE and self._bias == _BIAS.mjBIAS_NONE:
            self._omit("damping by its control (gainprm)")
        else:
            self._omit(f"gaintype {self._gain.name.removeprefix('mjGAIN_').lower()}")
        if self._forces is not None:
            self._add_effort(drive, None)
