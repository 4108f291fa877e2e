"""The files of the user that a piece of code has read are known, with digests of their contents."""

import ctypes
import importlib
import json
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from controller.laws.read_files import digest_of_file, files_read


def test_files_read_also_by_new_threads_are_known_by_their_content(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two", "unread"):
        Path(name).write_text(name)
    with files_read() as read:
        Path("one").read_text()
        Path("one").chmod(0o600)
        thread = threading.Thread(target=Path("two").read_bytes)
        thread.start()
        thread.join()
        Path(json.__file__).read_text()
        assert digest_of_file(Path("unread"))
    Path("unread").read_text()
    assert sorted(read) == [str(tmp_path / name) for name in ("one", "two", "unread")]
    assert read[str(tmp_path / "one")] == digest_of_file(tmp_path / "one")


def test_files_opened_by_unrelated_threads_are_no_inputs(tmp_path):
    """Such as the threads of a scheduler or a recorder in the same process."""
    own, foreign, scratch = tmp_path / "own", tmp_path / "foreign", tmp_path / "scratch"
    own.touch()
    foreign.touch()
    with ThreadPoolExecutor(1) as others:
        others.submit(int).result()  # which starts its thread
        with files_read() as read:
            others.submit(foreign.read_bytes).result()
            others.submit(scratch.write_bytes, b"1").result()
            own.read_bytes()
    assert list(read) == [str(own)]


def test_results_and_passing_files_are_no_inputs(tmp_path):
    with files_read() as read:
        (tmp_path / "log").write_text("x")
        (tmp_path / "log").read_text()
        (tmp_path / "passing").write_text("x")
        (tmp_path / "passing").unlink()
        with pytest.raises(OSError, match="missing"):
            (tmp_path / "missing").read_text()
        list(tmp_path.iterdir())
    assert read == {str(tmp_path / "log"): "", str(tmp_path / "missing"): "absent"}


def test_link_is_an_input_too(tmp_path):
    """It may lead to another file later."""
    (tmp_path / "target").write_text("x")
    (tmp_path / "link").symlink_to("target")
    with files_read() as read:
        (tmp_path / "link").read_text()
    assert read == {str(tmp_path / "link"): digest_of_file(tmp_path / "target")}


def test_modules_are_known_by_their_source_also_if_compiled_before(tmp_path, monkeypatch):
    file = tmp_path / "read_as_a_module.py"
    file.write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    for _ in range(2):  # the second time from __pycache__
        with files_read() as read:
            importlib.import_module("read_as_a_module")
        assert read == {str(file): digest_of_file(file)}
        del sys.modules["read_as_a_module"]


def test_library_of_ctypes_is_read(tmp_path):
    library = tmp_path / "no_library.so"
    library.write_text("nothing")
    with files_read() as read, pytest.raises(OSError, match="no_library"):
        ctypes.CDLL(str(library))
    assert list(read) == [str(library)]
