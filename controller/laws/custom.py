"""Custom laws: ``module:Class``, or a program (``external``).

Custom modules are found in the current folder, after installed ones.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import ConfigurationError
from controller.control_law import AroundLaw, ControlLaw, Diagnostics, Dynamics, Tracking
from controller.demonstrator import Demonstrator
from controller.errors import described, is_of_the_law
from controller.laws.read_files import OUR_FOLDER, files_read


def find_in_current_folder() -> None:
    """Let imports find the modules in the current folder, as with ``python -m``."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path += [OUR_FOLDER, here]  # in this order, as other processes inherit it


EXTERNAL = "external"
"""Name of the law that is a separate program."""

_LAW_KEY = "controller.law"
_left_out: ContextVar[bool] = ContextVar("custom laws are left out", default=False)
_GAINS_KEY = "controller.gains.custom"

Maker = Callable[..., ControlLaw]
"""Creates a law from the nominal model and its gains: usually a class."""

read_by_imports: list[dict[str, str]] = []
"""For each first import of a law in this process, the user's files that it read, with digests."""

_given: ContextVar[Mapping[str, Maker]] = ContextVar("laws given", default=MappingProxyType({}))


def is_custom(name: str) -> bool:
    """Whether a law is custom: a ``module:Class`` or a program."""
    if name == EXTERNAL:
        return True
    module, separator, class_name = name.partition(":")
    parts = module.split(".")
    return bool(separator) and all(part.isidentifier() for part in (*parts, class_name))


@contextmanager
def custom_laws_left_out() -> Iterator[None]:
    """Import and start no custom law while the context lasts: scenarios can be read, but not run.

    For scenarios in recordings, which are untrusted.
    """
    before = _left_out.set(True)
    try:
        yield
    finally:
        _left_out.reset(before)


def are_left_out() -> bool:
    """Whether `custom_laws_left_out` holds."""
    return _left_out.get()


@contextmanager
def laws_given(makers: Mapping[str, Maker]) -> Iterator[None]:
    """Use these laws for these names, without imports, while the context lasts."""
    before = _given.set({**_given.get(), **makers})
    try:
        yield
    finally:
        _given.reset(before)


def is_given(name: str) -> bool:
    """Whether a law of this name was given, within `laws_given`."""
    return name in _given.get()


SHIPPED = {"funnel_hil:Demonstrator": Demonstrator}
"""Custom laws that are ours, by name, whose code any command may use."""


class LeftOut:
    """Placeholder for a law that must not be imported or started; it returns no torque."""

    def __init__(self, joints: int) -> None:
        self.diagnostics = Diagnostics(joints)

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def torque(self, _tracking: Tracking) -> Vector:
        """Refuse to return a torque.

        Raises:
            RuntimeError: always.
        """
        raise RuntimeError("the law was left out")


class TargetsAlone(AroundLaw):
    """A custom law of targets without a method ``torque``: its torques are zero.

    It needs neither a method ``reset`` nor ``diagnostics``.

    Args:
        law: the law, with a method ``target``.
        joints: number of joints.
    """

    def __init__(self, law: Any, joints: int) -> None:
        self._law = law
        self._torque: Vector = np.zeros(joints)
        self._diagnostics = Diagnostics(joints)

    def __getattr__(self, name: str) -> Any:
        if name == "_law":  # not set yet, as in a copy
            raise AttributeError(name)
        return getattr(self._law, name)

    def torque(self, _tracking: Tracking) -> Vector:
        """Return zeros: a drive loop or the robot's own controller finds its torques."""
        return self._torque

    def reset(self) -> None:
        """Have the law forget everything."""
        if reset := getattr(self._law, "reset", None):
            reset()


def tell_lag(name: str, law: object, lag_s: float) -> None:
    """Give a custom law with a method ``make_up_for`` the lag of the robot's own controller.

    Raises:
        ConfigurationError: the method raises.
    """
    make_up_for = getattr(law, "make_up_for", None)
    if not callable(make_up_for):
        return
    try:
        make_up_for(lag_s)
    except BaseException as error:  # user code may raise any exception, or exit
        if not is_of_the_law(error):
            raise
        failed = f"its make_up_for({lag_s:g}) must not fail: {described(error)}"
        raise ConfigurationError(_LAW_KEY, name, failed) from error


def build_custom(name: str, gains: dict[str, Any], model: Dynamics) -> ControlLaw:
    """Return a new ``Class(model, **gains)``, or a placeholder within `custom_laws_left_out`.

    Raises:
        ConfigurationError: there is no such class, it refuses the gains, or its instance is no
            control law.
    """
    if are_left_out():
        return LeftOut(model.joints)
    make = find_law(name)
    try:
        law = make(model, **gains)
    except BaseException as error:  # user code may raise any exception, or exit
        if not is_of_the_law(error):
            raise
        raise ConfigurationError(
            _GAINS_KEY, gains, f"{name} cannot be created with these: {described(error)}"
        ) from error

    def has(method: str) -> bool:
        return callable(getattr(law, method, None))

    is_alone = has("target") and not has("torque")
    missing = [name for name in ("torque", "reset") if not (is_alone or has(name))]
    own = getattr(law, "diagnostics", None)
    if not (isinstance(own, Diagnostics) or (is_alone and own is None)):
        found = "" if own is None else f", not {type(own).__name__}"
        missing.append(f"diagnostics, a controller.control_law.Diagnostics{found}")
    if missing:
        hint = (
            ""
            if has("torque") or is_alone
            else "; a law of positions or velocities has target instead of torque"
        )
        raise ConfigurationError(
            _LAW_KEY, name, f"is not a control law: it lacks {', '.join(missing)}{hint}"
        )
    built: ControlLaw = TargetsAlone(law, model.joints) if is_alone else law
    return built


def default_gains(name: str) -> dict[str, Any]:
    """Return the numbers that a custom law's constructor has as defaults, by their names.

    Raises:
        ConfigurationError: there is no such class.
    """
    given = inspect.signature(find_law(name)).parameters.values()
    return {each.name: each.default for each in given if type(each.default) in (int, float, list)}


def find_law(name: str) -> Maker:
    """Return the class of a law; modules in the current folder are found, as with ``python -m``.

    Raises:
        ConfigurationError: there is none.
    """
    if name in _given.get():
        return _given.get()[name]
    module_name, _, class_name = name.partition(":")
    find_in_current_folder()
    try:
        with files_read() as read:
            module = importlib.import_module(module_name)
        if read:
            read_by_imports.append(read)
    except BaseException as error:
        if not is_of_the_law(error):
            raise
        raise ConfigurationError(
            _LAW_KEY, name, f"{module_name} cannot be imported: {described(error)}"
        ) from error
    make: Maker | None = getattr(module, class_name, None)
    if not callable(make):
        ours = str(getattr(module, "__file__", "")).startswith(f"{OUR_FOLDER}{os.sep}")
        whose = ", because funnel-hil has a module of that name: rename yours" if ours else ""
        raise ConfigurationError(_LAW_KEY, name, f"{module_name} has no class {class_name}{whose}")
    return make
