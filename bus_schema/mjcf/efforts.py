"""Largest torques of joints in MJCF: what its actuators can do."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from bus_schema.errors import RobotDescriptionError
from bus_schema.mjcf.settings import Attributes, Compiler, Defaults, numbers, vector
from bus_schema.urdf.checks import shortened


class Efforts:
    """Largest torques by joint.

    A motor's is its largest control times its gear; where an actuator or a joint has a range of
    forces, that limits it too. What other actuators make of their control is not known.

    Args:
        root: the file.
        defaults: of its classes.
        compiler: its settings.
    """

    def __init__(self, root: ET.Element, defaults: Defaults, compiler: Compiler) -> None:
        self._auto = compiler.auto_limits
        self._largest: dict[str, float] = {}
        for actuator in (each for part in root.findall("actuator") for each in part):
            attributes = defaults.of(actuator, None)
            owner = f"{actuator.tag} {attributes.get('name', '')}".strip()
            joint = attributes.get("joint") or attributes.get("jointinparent")
            if joint is None:
                raise RobotDescriptionError(f"{owner}: must drive a joint")
            if joint in self._largest:
                raise RobotDescriptionError(
                    f"{owner}: joint {shortened(joint)} has an actuator already: one is allowed"
                )
            gear = numbers(owner, attributes, "gear", "1")[:1]
            scale = abs(float(gear[0])) if gear.size else 1.0
            ranges = [self._range(owner, attributes, "force")]
            if actuator.tag == "motor":
                ranges.append(self._range(owner, attributes, "ctrl"))
            self._largest[joint] = scale * min(ranges)

    def drives(self, joint: str) -> bool:
        """Whether a joint has an actuator; in a file without any, every joint is to have one."""
        return joint in self._largest or not self._largest

    def of(self, joint: str, attributes: Attributes) -> float | None:
        """Largest torque (N m) or force (N) of a joint; None where nothing says it."""
        own = self._range(f"joint {joint}", attributes, "actuatorfrc")
        largest = min(own, self._largest.get(joint, float("inf")))
        return largest if largest < float("inf") else None

    def require_joints(self, known: set[str]) -> None:
        """Check that the joints of all actuators are there.

        Raises:
            RobotDescriptionError: one is not.
        """
        for joint in self._largest:
            if joint not in known:
                raise RobotDescriptionError(
                    f"joint={shortened(joint)!r} of an actuator: there is no such joint"
                )

    def _range(self, owner: str, attributes: Attributes, kind: str) -> float:
        """The larger end of a range, by size; inf where it does not hold."""
        limited = attributes.get(f"{kind}limited", "auto")
        if f"{kind}range" not in attributes or limited == "false":
            return float("inf")
        if limited == "auto" and not self._auto:
            return float("inf")
        return float(abs(vector(owner, attributes, f"{kind}range", "0 0")).max())
