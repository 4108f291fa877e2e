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
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from deploy.docs.reference_words import attributes_of, meanings, table, unit_of
from deploy.docs.scenario_keys import scenario
from deploy.judge.result.section import Figure, figures

STANDARD = {"--help", "--install-completion", "--show-completion"}
"""Options of every command."""
SHARED = "Options of several commands"


def commands() -> str:
    """Every command with its arguments and options, as the program itself describes them.

    Options that three or more commands share come first; a command only names them.
    """
    from deploy.cli.commands import COMMANDS, EARLIER, LazyCommand

    found = [
        inner
        for name in COMMANDS
        if name not in EARLIER
        for inner in _with_inner(LazyCommand(name).load(), name)
    ]
    count = Counter(tuple(row) for command, name in found for row in _options(command, name))
    shared = [list(row) for row, number in count.items() if number > 2 and row[0][1] == "-"]
    lines = [f"## {SHARED}\n", table(["option", "meaning"], shared) + "\n"]
    return "\n".join([*lines, *(line for each in found for line in _command(*each, shared))])


def _with_inner(command: Any, name: str) -> Iterator[tuple[Any, str]]:
    """A command with its name, and the commands in it."""
    yield command, name
    for inner, each in getattr(command, "commands", {}).items():
        yield from _with_inner(each, f"{name} {inner}")


def _command(command: Any, name: str, shared: list[list[str]]) -> Iterator[str]:
    yield f"## funnel-hil {name}\n"
    yield inspect.cleandoc(command.help or "") + "\n"
    rows = _options(command, name)
    if own := [row for row in rows if row not in shared]:
        yield table(["argument or option", "meaning"], own) + "\n"
    if others := [row[0].split()[0].strip("`") for row in rows if row in shared]:
        anchor = SHARED.lower().replace(" ", "-")
        yield f"[Also](#{anchor}): {', '.join(f'`{each}`' for each in others)}.\n"


def _options(command: Any, name: str) -> list[list[str]]:
    """Return usage and meaning of each argument and option."""
    context = typer.Context(command, info_name=f"funnel-hil {name}")
    return [
        [f"`{_usage(each)}`", _help(each)]
        for each in command.get_params(context)
        if not (STANDARD & set(each.opts) or getattr(each, "hidden", False))
    ]


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


def summary() -> str:
    """Every key of the ``summary.json`` of a run."""
    from deploy.judge.metrics import RunResult

    rows: dict[str, list[str]] = {}
    first: dict[type, str] = {}
    for each in figures(RunResult):
        place, key = _name(each.path[:-1]), f"`{_name(each.path)}`"
        if (earlier := first.setdefault(each.section, place)) != place:
            rows[place] = [f"`{place}.…`", "", f"the same keys as `{earlier}.…`"]
        elif meaning := _meaning(each):
            rows[key] = [key, unit_of(_name(each.path)), meaning]
    return table(["key", "unit", "meaning"], list(rows.values()))


def _name(path: tuple[str, ...]) -> str:
    """Return the dotted key of a figure."""
    return ".".join(path)


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
    known = {
        name: f"[`{_name(path)}`](#summaryjson)"
        for each in figures(RunResult)
        for name, path in each.columns.items()
    } | meanings()["columns"]
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


def python() -> str:
    """The functions of the Python API, with their parameters."""
    import funnel_hil

    functions = {name: getattr(funnel_hil, name) for name in funnel_hil.__all__}
    rows = [[f"`{name}({_parameters(each)})`", (inspect.getdoc(each) or "").partition("\n")[0]]
            for name, each in functions.items() if inspect.isfunction(each)]  # fmt: skip
    return table(["call", "does"], rows)


def _parameters(function: Any) -> str:
    """Return the parameters by name, without those that the page explains for all calls."""
    explained = {"workers", "scheduler", "out", "overwrite", "progress", "more", "definition"}
    names = [each for each in inspect.signature(function).parameters if each not in explained]
    return ", ".join(names)


TABLES = {
    each.__name__: each
    for each in (
        scenario,
        commands,
        summary,
        columns,
        loss_reasons,
        exit_codes,
        topics,
        python,
    )
}


REFERENCE = Path(__file__).with_name("reference")
_GENERATED = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end: \2 -->)", re.DOTALL)


def up_to_date(page: str) -> str:
    """Return a page with its generated parts made again."""

    def made_again(found: re.Match[str]) -> str:
        lines = TABLES[found[2]]().splitlines()
        text = "\n".join(line.rstrip() for line in lines).strip()
        text = re.sub(r"\n{3,}", "\n\n", text)
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
