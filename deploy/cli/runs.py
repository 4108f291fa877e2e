"""List, tag and remove folders of results."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer

from bus_schema.foreign_text import say
from deploy.judge.verdict import Verdict
from deploy.reports.run_index import IndexedResults, results_in, tag
from deploy.reports.terminal import fitted, open_table, width_of
from deploy.run.console import Console
from deploy.run.new_folder import remove_results
from deploy.scenario.scenario import SHIPPED
from deploy.scenario.yaml_files import FAULTS, ScenarioError
from deploy.study.definition import SHIPPED as SHIPPED_STUDIES

app = typer.Typer(help=__doc__, no_args_is_help=True)
Folder = Annotated[Path, typer.Argument(help="Folder that contains the folders of results.")]
_UNFINISHED = [each.listed for each in (Verdict.NOTHING, Verdict.INTERRUPTED)]
_MIB = 1 << 20
_WIDEST = 100_000
_HEADINGS = ["Folder", "Begun", "Kind", "What", "Result", "Tags", "MiB"]
_FOLDER, _WHAT, _TAGS = (_HEADINGS.index(each) for each in ("Folder", "What", "Tags"))
_GAP = 2


def scenarios() -> None:
    """List the shipped scenarios and studies."""
    use = "run, simulate, compare, margin"
    for folder, title, before in (
        (SHIPPED, f"{SHIPPED.name} ({use})", ""),
        (SHIPPED / FAULTS, f"{SHIPPED.name} in which something breaks (the same)", f"{FAULTS}/"),
        (SHIPPED_STUDIES, f"{SHIPPED_STUDIES.name} (studies)", ""),
    ):
        files = sorted(folder.glob("*.yaml"))
        rows = ((before + file.stem, _first_sentence(file)) for file in files)
        Console().print(open_table(title, ("Name", "Description"), rows, _GAP))


@app.command("list")
def list_runs(
    folder: Folder = Path("runs"),
    only: Annotated[
        str | None, typer.Option("--tag", metavar="TAG", help="List only results with this tag.")
    ] = None,
) -> None:
    """List the results in a folder, oldest first."""
    found = [each for each in results_in(folder) if only is None or only in each.tags]
    _show(found, Console())


@app.command("tag")
def tag_run(
    path: Annotated[Path, typer.Argument(metavar="RUN", help="A folder of results.")],
    tags: Annotated[list[str] | None, typer.Argument(metavar="[TAG]…", help="Tags to add.")] = None,
    remove: Annotated[
        list[str] | None, typer.Option(metavar="TAG", help="Tag to remove; repeatable.")
    ] = None,
) -> None:
    """Tag a run, comparison or study. `prune` keeps tagged results."""
    say(", ".join(tag(path, tags or [], remove or [])) or "no tags")


@app.command("prune")
def prune(
    folder: Folder = Path("runs"),
    older_than: Annotated[
        float | None, typer.Option(metavar="DAYS", min=0.0, help="Remove results older than this.")
    ] = None,
    incomplete: Annotated[
        bool,
        typer.Option(
            "--incomplete", help="Remove unfinished results, except those that a fault ended."
        ),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Remove; without this option, only list.")
    ] = False,
) -> None:
    """Remove results without a tag. If both conditions are given, both must apply.

    Files that funnel-hil did not write stay, and so do their folders.
    """
    if older_than is None and not incomplete:
        raise ScenarioError("runs prune: give --older-than, --incomplete, or both")
    chosen = [
        each for each in results_in(folder)
        if not each.tags
        and (older_than is None or _is_older(each, older_than))
        and (not incomplete or each.result in _UNFINISHED)
    ]  # fmt: skip
    _show(chosen, Console())
    if not yes:
        print(f"{len(chosen)} would be removed; --yes removes them")
        return
    for each in chosen:
        remove_results(each.path)
    print(f"{len(chosen)} removed")


def _is_older(each: IndexedResults, days: float) -> bool:
    """Whether it was begun so long ago; not where nothing says when."""
    if each.started is None:
        return False
    return datetime.now(each.started.tzinfo) - each.started >= timedelta(days=days)


def _show(found: list[IndexedResults], console: Console) -> None:
    """A line for each, however narrow the terminal is; another program gets all of it."""
    rows = [_HEADINGS, *map(_cells, found)]
    if not console.is_terminal:
        console.width = _WIDEST
    elif not any(each.tags for each in found):
        rows = [row[:_TAGS] + row[_TAGS + 1 :] for row in rows]
    room = console.width - _GAP * (len(rows[0]) - 1)
    if width_of(rows) > room:  # all are in the folder that was asked for
        rows[1:] = [[each.path.name, *row[1:]] for each, row in zip(found, rows[1:], strict=True)]
    headings, *cells = fitted(rows, room, may_shrink=(_FOLDER, _WHAT))
    console.print(open_table(None, headings, cells, _GAP))


def _cells(each: IndexedResults) -> list[str]:
    """The texts below `_HEADINGS`."""
    begun = "" if each.started is None else f"{each.started:%Y-%m-%d %H:%M}"
    size = f"{each.size_bytes / _MIB:.1f}"
    return [str(each.path), begun, each.kind, each.what, each.result, ", ".join(each.tags), size]


def _first_sentence(file: Path) -> str:
    """Return the first sentence of the comment at the top of a shipped file."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines).partition(". ")[0].rstrip(".") + "." if lines else ""
