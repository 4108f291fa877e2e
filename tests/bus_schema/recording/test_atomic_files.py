import os

import pytest

from bus_schema.recording.atomic_files import RecordFile, new_partial, write_whole
from bus_schema.recording.mcap_log import McapLog
from bus_schema.user_files import read_bytes
from deploy.judge.run_rows import write_rows


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("report.html", lambda path: write_whole(path, "page")),
        ("run.mcap", lambda path: McapLog(path, 1000.0).close()),
        ("sweep.parquet", lambda path: write_rows([], path)),
        ("other.bin", lambda path: RecordFile(new_partial(path)).write(b"1")),
    ],
)
@pytest.mark.parametrize("is_partial", [True, False])
def test_nothing_is_written_through_links_in_a_folder_of_results(tmp_path, name, write, is_partial):
    target, path = tmp_path / "target", tmp_path / name
    target.write_text("mine")
    link = path.with_name(f"{path.stem}.partial{path.suffix}") if is_partial else path
    link.symlink_to(target)
    write(path)
    assert target.read_text() == "mine"


@pytest.mark.parametrize("kind", ["fifo", "device", "folder", "sparse", "circle"])
def test_only_regular_files_of_a_size_are_read(tmp_path, kind):
    path = tmp_path / "given"
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "circle":
            path.symlink_to(path)
        case "sparse":
            with path.open("wb") as file:
                file.truncate(3 << 30)
    with pytest.raises(OSError, match=r"not a regular file|folder|larger than 20 MB|ymbolic"):
        read_bytes(path)
