import pytest

from deploy.run.execute import InProcess, InProcesses, execute, lockstep_setup
from deploy.run.new_folder import new_folder
from deploy.run.run_folder import RunFolder, RunFolderError, load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup


def test_folder_that_is_overwritten_keeps_no_recording_of_the_run_before_and_all_else(tmp_path):
    for name in ("run.mcap", "run-2.mcap", "run-3.partial.mcap", "can-2.log"):
        (tmp_path / name).write_text("old")
    for name in ("notes.txt", "run-mine.mcap", "can-trace.log"):
        (tmp_path / name).write_text("the user's")
    new_folder("again", tmp_path, overwrite=True)
    left = sorted(file.name for file in tmp_path.iterdir())
    assert left == ["can-trace.log", "notes.txt", "run-mine.mcap"]


@pytest.mark.parametrize("name", ["summary.json", "manifest.json", "tags.json"])
def test_deep_json_in_one_folder_breaks_no_list_of_all(tmp_path, funnel_hil, name):
    for folder in ("good", "deep"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "summary.json").write_text('{"scenario": "s", "completed": true}')
        (tmp_path / folder / "manifest.json").write_text("{}")
    (tmp_path / "deep" / name).write_text("[" * 100_000)
    output = funnel_hil.output("runs", "list", tmp_path)
    assert "good" in output
    assert "deep" in output


def test_a_run_says_when_its_law_is_done_before_it_writes(tmp_path):
    """So that no deadline of a law that does not end cuts the recording off."""
    with RunFolder.begin(load_setup("paper_arm", ["duration_s=0.02"]), tmp_path / "r") as folder:
        setup, there = load_setup(str(folder.scenario)), []
        execute(setup, InProcess(on_end=lambda: there.append(folder.log.exists())), folder)
        assert there == [False]
        assert folder.log.exists()


def test_a_run_in_processes_without_a_folder_is_read_before_its_own_goes():
    setup = lockstep_setup(load_setup("paper_arm", ["duration_s=0.02"]))
    run = execute(setup, InProcesses())
    assert run.summary["verdict"] == "kept"
    assert run.path is None


def test_damaged_scenario_is_reported_as_damage(tmp_path):
    """Zeros over a checksum switch it off: then only the checksum of the whole file is left."""
    file = tmp_path / "run.mcap"
    simulate(load_setup("paper_arm", ["duration_s=0.02"])).write_log(file)
    data = bytearray(file.read_bytes())
    end = data.index(b"</robot>") + len(b"</robot>\n")
    data[end - 50 : end + 4] = bytes(54)  # the checksum of an attachment stands behind it
    file.write_bytes(data)
    with pytest.raises(RunFolderError, match=r"scenario cannot be used: .*; it is damaged: "):
        load_run(file)
