"""The first answer of a policy, asked before a study plans its runs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable

from bus_schema.configuration import ConfigurationError
from bus_schema.link.in_process import InProcessBus
from bus_schema.runtime.clock import VirtualClock
from controller.chunks.answer import AnswerShapeError
from controller.control_loop import ControlLoop
from controller.errors import LawError
from controller.laws.custom import EXTERNAL, is_custom
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming


def require_answers(setups: Iterable[Setup]) -> None:
    """Check that policies answer with the shape that their scenarios need.

    Custom laws of a scenario with a horizon of actions are asked once, as at the start of a run;
    others are not, as a law may count its questions.

    Raises:
        ScenarioError: an answer has another shape, so that every run would fail.
    """
    first = {(each.scenario.name, each.scenario.controller.law): each for each in setups}
    for (_, law), setup in first.items():
        chunks = setup.scenario.controller.chunks
        has_horizon = chunks is not None and chunks.horizon is not None
        if has_horizon and is_custom(law) and law != EXTERNAL:
            _require_answer(setup)


def _require_answer(setup: Setup) -> None:
    link = setup.link_kind.open_controller(
        setup.link_run(lockstep=True, bus=InProcessBus(VirtualClock()))
    )
    with contextlib.closing(link), naming(setup.origin):
        try:
            ControlLoop(setup.control_task(), link).warm_up()
        except LawError as error:
            if isinstance(error.__cause__, AnswerShapeError):
                law = setup.scenario.controller.law
                raise ConfigurationError("controller.law", law, str(error.__cause__)) from error
