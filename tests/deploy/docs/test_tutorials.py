"""Every code block of the tutorials runs as it stands there, with shorter runs."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.docs.pages import DOCS, Block, blocks, commands
from tests.multicast import own_place
from tests.waiting import HANG_S
from tests.warm_process import ROOT, WITHOUT_REPORT, WarmProcess, here, no_report

GROUP = "239.74.163.8"
"""Of the tutorial on drives; tests at the same time need groups and ports of their own."""


def save(block: Block, page: Path, folder: Path) -> None:
    """Write the file that a block with a caption stands for."""
    caption = re.search(r"^:caption: (\S+)\n", block.text, re.MULTILINE)
    if caption is None:
        return
    included = re.fullmatch(r"\{literalinclude\} (\S+)", block.language)
    if included:
        shutil.copy(page.parent / included[1], folder / caption[1])
    else:
        (folder / caption[1]).write_text(block.text.partition("\n\n")[2])


class Shell:
    """Runs commands in the current folder; those of funnel-hil in this process.

    What runs in the background is a process that has its libraries.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        scripts = Path(sys.executable).parent
        path = os.pathsep.join([str(scripts), os.environ["PATH"]])
        self.environment = {
            **os.environ,
            "PATH": path,
            "PYTHONPATH": f"{ROOT}:{folder}",
            "COLUMNS": "100",
        }
        self.in_background: list[WarmProcess] = []

    def run(self, words: list[str], notes: dict[str, str]) -> None:
        more = shlex.split(notes.get("adds") or notes.get("runs in the background") or "")
        if words[0] != "funnel-hil":
            subprocess.run(words, cwd=self.folder, env=self.environment, check=True, timeout=HANG_S)
            return
        if words[-1] == "&":
            process = WarmProcess(
                *words[1:-1], *more, cwd=self.folder, environment=self.environment,
                main=WITHOUT_REPORT,
            )  # fmt: skip
            self.in_background.append(process)
            return
        with no_report():
            code, output = here(*words[1:], *more, **self.environment)
        assert code == int(notes.get("exits", 0)), f"{words}: {output}"

    def end(self) -> None:
        for process in self.in_background:
            process.kill()


@pytest.mark.parametrize(
    "page", sorted((DOCS / "tutorials").glob("*.md")), ids=lambda page: page.stem
)
def test_code_blocks_of_a_tutorial_run(page: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    shell, names = Shell(tmp_path), {}
    group, port = own_place()
    try:
        for shown in blocks(page):
            if "skips" in shown.notes:
                continue
            text = shown.text.replace(GROUP, group).replace("43113", str(port))
            block = shown._replace(text=text)
            save(block, page, tmp_path)
            if block.language == "python":
                exec(block.text, names)
            elif block.language == "sh":
                for words in commands(block.text):
                    shell.run(words, block.notes)
    finally:
        shell.end()
        for name, module in list(sys.modules.items()):  # another test may have one of that name
            if str(getattr(module, "__file__", None)).startswith(str(tmp_path)):
                del sys.modules[name]
