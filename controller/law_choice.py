"""Choice of the law in a scenario: shipped, custom or a program; and the gains of each."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache
from pathlib import PurePath
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PlainValidator, create_model

from bus_schema.configuration import Sections, StrictModel
from controller.laws import LAWS
from controller.laws.custom import EXTERNAL, is_custom
from controller.policies.configuration import is_address

PROCESS = "process"
"""In place of a law's name: the controller is a user's own process on the bus."""
_INTERPRETER = re.compile(r"env|(ba|da|z)?sh|node|ruby|perl|lua|julia|java|((py)?py|python)[\d.]*")
_PLAIN_NAME = re.compile(r"[\w.+/-]{1,200}")


def is_program(name: str) -> bool:
    """Whether the controller of this name is a program: the law ``external``, or a process."""
    return name == EXTERNAL or name.startswith(f"{PROCESS}: ")


def is_law_name(name: str) -> bool:
    """Whether a name is a law, a custom one, a policy server's address, or a process."""
    return name in LAWS or name == PROCESS or is_custom(name) or is_address(name)


def _to_word(value: Any) -> Any:
    """Convert a number, as YAML reads it, to a word of a command line."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return str(value) if is_number else value


Word = Annotated[str, BeforeValidator(_to_word), Field(min_length=1)]
"""A word of a command line."""


def program_name(command: tuple[str, ...]) -> str:
    """Return the name of a command's program; for an interpreter, that of its script."""
    program, *arguments = command
    scripts = [word for word in arguments if not word.startswith("-")]
    is_interpreter = _INTERPRETER.fullmatch(PurePath(program).name) is not None
    if is_interpreter and scripts and _PLAIN_NAME.fullmatch(scripts[0]):
        program = scripts[0]
    return PurePath(program).stem


def _check_gains(given: Any) -> dict[str, Any]:
    """Validate gains by law; of the extensions, those named are loaded."""
    named = [law for law in given if isinstance(law, str)] if isinstance(given, dict) else []
    checked = _section_now(named).model_validate(given)
    return {law: gains for law, gains in checked if gains is not None}


def _section_now(only: Collection[str] | None) -> type[StrictModel]:
    """Return the section of gains, with the extensions of these names; None for all usable ones."""
    entries = LAWS.usable(only)
    unusable = [(law, dict[str, Any]) for law in only or () if law in LAWS and law not in entries]
    return _gains_section((*((law, entry.gains) for law, entry in entries.items()), *unusable))


@cache  # creating it takes 15 ms, each time a scenario is read
def _gains_section(types: tuple[tuple[str, Any], ...]) -> type[StrictModel]:
    """Return a section with gains of these types by the name of their law, and ``custom`` ones."""
    fields: dict[str, Any] = {law: (gains | None, None) for law, gains in types}
    fields["custom"] = (dict[str, Any], Field(default_factory=dict))
    return create_model("Gains", __base__=StrictModel, **fields)


GainsByLaw = Annotated[
    dict[str, Any], PlainValidator(_check_gains), Sections(lambda only: [_section_now(only)])
]
