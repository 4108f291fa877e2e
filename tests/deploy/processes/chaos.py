"""Random trouble for whole simulations: a bad link, and hostile commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import CommandArrival
from bus_schema.messages.layout import Record
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, layout
from bus_schema.runtime.clock import VirtualClock
from controller.control_loop import ControlLoop
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from plant_emulator.plant_loop import PlantLoop
from plant_emulator.plant_task import PlantOutcome

HUGE_NM = 1e6
ATTACKS = ("other_commander", "replay", "old_stamp", "not_finite", "huge", "garbage", "future")
_COMMANDER = b"controller"


def random_setup(random: np.random.Generator) -> Setup:
    """A short run over a random bad link, with random limits."""
    link = [f"link.{way}={_direction(random)}" for way in ("uplink", "downlink")]
    stop = random.choice(["brake", "damping", "zero_torque"])
    law = random.choice(["fixed_time_neural", "pid", "smc"])
    return load_setup(
        "paper_arm",
        [
            "duration_s=0.3",
            f"seed={int(random.integers(1, 10_000))}",
            f"controller.law={law}",
            *link,
            f"plant.command_timeout_ms={random.integers(5, 60)}",
            f"plant.safe_stop={stop}",
            "plant.stop_duration_s=0.05",
            f"limits.torque_nm={random.uniform(20.0, 400.0):.3f}",
            f"limits.torque_rate_nm_s={random.choice([1e3, 1e5, 1e9])}",
            f"limits.velocity_rad_s={random.uniform(0.3, 6.0):.3f}",
            f"limits.on_velocity={random.choice(['count', 'cut', 'stop'])}",
        ],
    )


def _direction(random: np.random.Generator) -> str:
    """A direction of the link, in YAML."""
    keys = {
        "delay_ms": random.uniform(0.0, 6.0),
        "jitter_ms": random.uniform(0.0, 4.0),
        "duplicate": random.choice([0.0, 0.2]),
        "loss": random.choice([0.0, 0.05, 0.3]),
        "reorder": str(bool(random.integers(2))).lower(),
    }
    if random.integers(2):
        at_s, for_s = random.uniform(0.05, 0.2), random.uniform(0.005, 0.1)
        keys["schedule"] = f"[{{kind: outage, at_s: {at_s:.4f}, for_s: {for_s:.4f}}}]"
    return "{" + ", ".join(f"{name}: {value}" for name, value in keys.items()) + "}"


class HostilePlantLink(InProcessPlantLink):
    """The plant's link with hostile commands before and behind those of the controller.

    Attributes:
        arrivals: all that arrived, hostile or not.
        hostile: how many of them were.
    """

    def __init__(
        self, bus: InProcessBus, names: tuple[str, ...], random: np.random.Generator, share: float
    ) -> None:
        super().__init__(bus)
        self._attacked_bus, self._random, self._share = bus, random, share
        self._states = layout(JOINT_STATES, names)
        self._state = Record(self._states)
        self._command = Record(layout(JOINT_COMMANDS, names))
        self._received: list[CommandArrival] = []
        self.arrivals = 0
        self.hostile = 0

    def send_state(self, state: bytes, status: bytes) -> None:
        super().send_state(state, status)
        self._states.decode(state, self._state)
        commands, self._attacked_bus.commands = self._attacked_bus.commands, []
        for command in commands:
            own = command._replace(sender=_COMMANDER)
            attack = self._random.choice(ATTACKS)
            is_attacked = bool(self._received) and self._random.random() < self._share
            self._attacked_bus.commands.append(own)
            if is_attacked:
                place = int(self._random.integers(2)) - 1 or len(self._attacked_bus.commands)
                self._attacked_bus.commands.insert(place, self._hostile_command(str(attack), own))
                self.hostile += 1
            self._received.append(own)

    def take_commands(self) -> list[CommandArrival]:
        taken = super().take_commands()
        self.arrivals += len(taken)
        return taken

    def _hostile_command(self, attack: str, own: CommandArrival) -> CommandArrival:
        """A hostile command that no plant may obey."""
        stamp_ns, torque = self._state.stamp_ns, HUGE_NM
        payload, sequence, sender = None, own.sequence + 10**6, b"stranger"
        match attack:
            case "replay":
                return self._received[int(self._random.integers(len(self._received)))]
            case "old_stamp":
                stamp_ns, sequence, sender = 0, self._received[-1].sequence, _COMMANDER
            case "not_finite":
                torque, sender = float(self._random.choice([np.nan, np.inf, -np.inf])), _COMMANDER
            case "huge":
                sequence, sender = self._received[-1].sequence, _COMMANDER
            case "garbage":
                payload = self._random.bytes(int(self._random.integers(0, 300)))
            case "future":
                stamp_ns, sender = stamp_ns + 10**9, _COMMANDER
        self._command.stamp_ns = stamp_ns
        self._command.fields["effort"][:] = torque
        return CommandArrival(
            self._command.payload() if payload is None else payload,
            sequence, sender, own.arrival_ns,
        )  # fmt: skip


@dataclass(frozen=True)
class AttackedRun:
    """A run under attack.

    Attributes:
        largest_nm: largest torque that any command in force asked for.
    """

    setup: Setup
    bus: InProcessBus
    link: HostilePlantLink
    outcome: PlantOutcome
    largest_nm: float


def run_under_attack(seed: int) -> AttackedRun:
    """Run a random setup under random attacks."""
    random = np.random.default_rng(seed)
    setup = random_setup(random)
    clock = VirtualClock()
    bus = InProcessBus(clock)
    controller = ControlLoop(setup.control_task(), InProcessControllerLink(bus))
    controller.warm_up()
    link = HostilePlantLink(bus, setup.robot.joint_names, random, share=random.uniform(0.0, 0.5))
    arm, asked = setup.arm(), [0.0]
    command = arm.command

    def note_command(torque_nm: Vector, *rest: Any) -> None:
        asked.append(float(np.abs(torque_nm).max()))
        command(torque_nm, *rest)

    arm.command = note_command
    outcome = PlantLoop(setup.plant_task(lockstep=True), arm, link, clock).run()
    controller.end()
    arm.close()
    return AttackedRun(setup, bus, link, outcome, max(asked))
