"""Write the tables of the reference from the code: keys, commands, results and topics.

The text between ``<!-- generated: NAME -->`` and ``<!-- end: NAME -->`` in a page is what a
function of `TABLES` returns. Git has the result, so that it can be read without building the site.
`meanings.yaml` must explain each key of a real ``summary.json`` and nothing else.

    .venv/bin/python -m deploy.docs.generated_reference
"""

from __future__ import annotations

import inspect
import re
import tempfile
import types
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import typer
import yaml
from pydantic import BaseModel

from bus_schema.configuration import Sections
from bus_schema.foreign_text import markdown_table
from bus_schema.registry import REGISTRIES, NameIn
from bus_schema.units import split_unit
from deploy.judge.result.section import Figure, figures

PLAIN = {bool: "true or false", int: "whole number", float: "number", str: "text", Any: "anything",
         types.NoneType: "must be left out"}  # fmt: skip
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
STANDARD = {"--help", "--install-completion", "--show-completion"}
"""Options of every command."""
PER_JOINT = {"_require_positive": ", > 0", "_require_non_negative": ", ≥ 0"}


def unit_of(name: str) -> str:
    """Return the unit that a name ends with; empty for none."""
    return split_unit(name)[1]


def table(header: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown; docstrings have code between two backticks."""
    return markdown_table(header, [[cell.replace("``", "`") for cell in row] for row in rows])


def attributes_of(section: type) -> dict[str, str]:
    """Return the meaning of each key, from the docstrings of a class and its bases."""
    found: dict[str, str] = {}
    for each in reversed(section.__mro__):
        text = inspect.cleandoc(each.__doc__ or "").partition("Attributes:")[2]
        found |= re.findall(r"^ {1,4}(\w+): (.*(?:\n {5,}.*)*)", text, re.MULTILINE)
    return found


def values_of(hint: Any) -> str:
    """Return the values that a type allows, in words."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        if named := [each for each in parts if isinstance(each, NameIn)]:
            return ", ".join(f"`{name}`" for name in REGISTRIES[named[0].kind].shipped)
        return values_of(parts[0]) + "".join(_limits(each) for each in parts[1:])
    if origin is Literal:
        return ", ".join(f"`{each}`" for each in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(values_of(p) for p in parts if p is not types.NoneType))
    if origin in (tuple, list):
        return f"list of: {values_of(parts[0])}"
    if origin is np.ndarray:
        return "number, or one per joint"
    if origin is dict or hint is dict:
        return "mapping"
    return PLAIN.get(hint, "section")


def _limits(metadata: Any) -> str:
    """Return the range that one entry of `Annotated` adds, also for the numbers of all joints."""
    inner = getattr(metadata, "metadata", [metadata])
    function = getattr(metadata, "func", None)
    ranges = [
        f", {sign} {limit:g}"
        for each in inner
        for name, sign in BOUNDS.items()
        if (limit := getattr(each, name, None)) is not None and abs(limit) < 1e12
    ]
    return "".join(ranges) + PER_JOINT.get(getattr(function, "__name__", ""), "")


def sections_in(hint: Any) -> Iterator[type]:
    """The sections that a type is made of."""
    if isinstance(hint, Sections):  # in `Annotated`: classes from a table of the product
        yield from hint.find(())
    elif inspect.isclass(hint) and (issubclass(hint, BaseModel) or hasattr(hint, "_fields")):
        yield hint
    for part in get_args(hint):
        yield from sections_in(part)


def scenario() -> str:
    """Every key of a scenario, a table for each section."""
    import deploy.scenario.checking.checks  # noqa: F401  (creates all registries)
    from deploy.scenario.definition import ScenarioConfiguration

    return "\n".join(_section(ScenarioConfiguration, "", {}))


def uncertainty() -> str:
    """The keys of a range."""
    from deploy.scenario.uncertainty import Draw

    return "\n".join(_section(Draw, "uncertainty.KEY", {}))


def _section(section: type, path: str, seen: dict[type, str]) -> Iterator[str]:
    seen[section] = path
    hints = get_type_hints(section, include_extras=True)
    hints = {name: hints[name] for name in getattr(section, "model_fields", hints)}
    words, rows, inner = meanings()["keys"] | attributes_of(section), [], []
    for name, hint in hints.items():
        field = getattr(section, "model_fields", {}).get(name)
        key = getattr(field, "alias", None) or name
        found = dict.fromkeys(sections_in(hint))
        places = [seen.get(each) or _place(each, f"{path}.{key}".strip(".")) for each in found]
        inner += [(e, place) for e, place in zip(found, places, strict=True) if e not in seen]
        seen |= dict(zip(found, places, strict=True))
        links = ", ".join(f"[`{_kind(p)}`](#{_anchor(p)})" for p in dict.fromkeys(places))
        kinds = [values_of(hint), unit_of(key)] if not links else [links]
        if name not in words and not links:
            raise ValueError(
                f"{section.__name__}.{name}: neither docstring nor meanings.yaml has it"
            )
        meaning = words[name] if not links else attributes_of(section).get(name, "")
        rows.append([f"`{key}`", ", ".join(filter(None, kinds)), _default(section, name), meaning])
    yield f"## {path or 'The file itself'}\n"
    about = inspect.cleandoc(section.__doc__ or "").partition("Attributes:")[0]
    if about and "(" not in about.partition("\n")[0].partition(" ")[0]:  # not NamedTuple's own
        yield about.replace("``", "`") + "\n"
    yield table(["key", "values", "default", "effect"], rows)
    for each, place in inner:
        yield from _section(each, place, seen)


def _place(section: type, key: str) -> str:
    """Return the place of a section: its key, with its kind where there are several."""
    kind = get_args(get_type_hints(section, include_extras=True).get("kind"))
    return f"{key} ({kind[0]})" if len(kind) == 1 else key


def _kind(place: str) -> str:
    """Return the name of a section in links: its kind, if it has one."""
    return re.sub(r"[^(]*\((\w+)\)$", r"\1", place)


def _anchor(heading: str) -> str:
    """Return the anchor that GitHub and the site give a heading."""
    return re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")


def _default(section: type, name: str) -> str:
    fields = getattr(section, "model_fields", None)
    if fields is None:
        defaults = section._field_defaults  # type: ignore[attr-defined]  # of a NamedTuple
        default = defaults.get(name, "needed")
    elif fields[name].is_required():
        default = "needed"
    else:
        default = fields[name].get_default(call_default_factory=True)
    if isinstance(default, np.ndarray):
        default = default.tolist() if default.size > 1 else f"{default.item():g}"
    if isinstance(default, BaseModel | dict | tuple) or default is None:
        return ""
    return "needed" if default == "needed" else f"`{str(default).lower()}`"


def commands() -> str:
    """Every command with its arguments and options, as the program itself describes them."""
    from deploy.cli.commands import COMMANDS, EARLIER, LazyCommand

    names = [name for name in COMMANDS if name not in EARLIER]
    return "\n".join(line for name in names for line in _command(LazyCommand(name).load(), name))


def _command(command: Any, name: str) -> Iterator[str]:
    context = typer.Context(command, info_name=f"funnel-hil {name}")
    yield f"## funnel-hil {name}\n"
    yield inspect.cleandoc(command.help or "") + "\n"
    rows = [
        [f"`{_usage(each)}`", _help(each)]
        for each in command.get_params(context)
        if not (STANDARD & set(each.opts) or getattr(each, "hidden", False))
    ]
    if rows:
        yield table(["argument or option", "meaning"], rows)
    for inner, each in getattr(command, "commands", {}).items():
        yield from _command(each, f"{name} {inner}")


def _usage(parameter: Any) -> str:
    """Return how to write an argument or option; the same with every version of typer."""
    word = parameter.metavar or parameter.name.upper()
    if parameter.param_type_name == "argument":
        return str(word)
    names = " / ".join([*parameter.opts, *parameter.secondary_opts])
    return names if parameter.is_flag else f"{names} {word}"


def _help(parameter: Any) -> str:
    """Return the help of an argument or option, with its range and default."""
    kind, default = getattr(parameter, "type", parameter), parameter.default
    ends = [("≥", getattr(kind, "min", None)), ("≤", getattr(kind, "max", None))]
    notes = [f"{sign} {limit:g}" for sign, limit in ends if limit is not None]
    if isinstance(parameter.show_default, str):
        notes.append(f"default: {parameter.show_default}")
    elif parameter.show_default and not (
        default is None or isinstance(default, bool) or default in ("", [])
    ):
        is_float = isinstance(default, float)
        notes.append(f"default: {default:g}" if is_float else f"default: {default}")
    if parameter.required:
        notes.append("needed")
    text = (parameter.help or "").replace("\\[", "[")  # Rich's escape
    return " ".join(filter(None, [text, f"[{', '.join(notes)}]" if notes else ""]))


@cache
def meanings() -> dict[str, dict[str, str]]:
    """Return the words that the code does not have: for keys of results and for exit codes."""
    found: dict[str, dict[str, str]] = yaml.safe_load(
        Path(__file__).with_name("meanings.yaml").read_text(encoding="utf-8")
    )
    return found


def summary() -> str:
    """Every key of the ``summary.json`` of a run."""
    from deploy.judge.metrics import RunResult

    rows = [[f"`{'.'.join(each.path)}`", unit_of(each.path[-1]), _meaning(each)]
            for each in figures(RunResult)]  # fmt: skip
    return table(["key", "unit", "meaning"], [row for row in rows if row[-1]])


def _meaning(figure: Figure) -> str:
    """Return the words of a figure; those of a part are optional, as its figures have some."""
    found = attributes_of(figure.section).get(figure.path[-1], "")
    if not found and not figure.is_part:
        raise ValueError(f"{figure.section.__name__}: no docstring explains {figure.path[-1]}")
    return " ".join(found.split())


def columns() -> str:
    """Every column of the Parquet file of a short comparison."""
    from pyarrow import parquet

    import funnel_hil
    from deploy.judge.metrics import RunResult

    with tempfile.TemporaryDirectory() as folder:
        short = {"extends": "paper_arm", "name": "short", "duration_s": 0.01}
        funnel_hil.compare(short, laws=["pid"], out=Path(folder) / "found")
        schema = parquet.read_schema(next(Path(folder).rglob("*.parquet")))
    known = {name: _meaning(each) for each in figures(RunResult) for name in each.columns}
    known |= meanings()["columns"]
    rows = [[f"`{each.name}`", str(each.type), unit_of(each.name), known[each.name]]
            for each in schema]  # fmt: skip
    return table(["column", "type", "unit", "meaning"], rows)


def loss_reasons() -> str:
    """Every reason why a run was lost."""
    from deploy.judge.findings.loss_reason import Reason

    return table(["reason", "meaning"], [[f"`{each}`", each.meaning] for each in Reason])


def exit_codes() -> str:
    """The exit codes."""
    from deploy.run import exit_codes as codes

    names = meanings()["exit_codes"]
    return table(["code", "meaning"], [[str(getattr(codes, n)), t] for n, t in names.items()])


def topics() -> str:
    """The table of topics, and each message type of our own."""
    from bus_schema.messages import topics as known

    names = meanings()["topics"]
    found = {each.name: each for each in vars(known).values() if isinstance(each, known.Topic)}
    rows = [[f"`{name}`", f"`{t.type_name}`", t.sender or "controller, plant", t.rate, names[name]]
            for name, t in found.items()]  # fmt: skip
    lines = ["## Topics\n", table(["topic", "type", "sent by", "when", "content"], rows)]
    files = sorted(Path(inspect.getfile(known)).parent.rglob("*.msg"))
    heading = "## funnel_hil_msgs/msg/{}\n\n```text\n{}```\n"
    return "\n".join(lines + [heading.format(file.stem, file.read_text()) for file in files])


TABLES = {
    each.__name__: each
    for each in (
        scenario,
        uncertainty,
        commands,
        summary,
        columns,
        loss_reasons,
        exit_codes,
        topics,
    )
}


REFERENCE = Path(__file__).with_name("reference")
_GENERATED = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end: \2 -->)", re.DOTALL)


def up_to_date(page: str) -> str:
    """Return a page with its generated parts made again."""

    def made_again(found: re.Match[str]) -> str:
        lines = TABLES[found[2]]().splitlines()
        text = "\n".join(line.rstrip() for line in lines).strip()
        return f"{found[1]}\n{text}\n\n{found[3]}"

    return _GENERATED.sub(made_again, page)


def main() -> None:
    """Bring the pages of the reference up to date."""
    for page in sorted(REFERENCE.glob("*.md")):
        before = page.read_text(encoding="utf-8")
        if (text := up_to_date(before)) != before:
            page.write_text(text, encoding="utf-8")
            print(f"wrote {page}")


if __name__ == "__main__":
    main()
