from deploy.runs.new_folder import new_folder


def test_folder_that_is_overwritten_keeps_no_recording_of_the_run_before_and_all_else(tmp_path):
    for name in ("run.mcap", "run-2.mcap", "run-3.partial.mcap", "can-2.log"):
        (tmp_path / name).write_text("old")
    for name in ("notes.txt", "run-mine.mcap", "can-trace.log"):
        (tmp_path / name).write_text("the user's")
    new_folder("again", tmp_path, overwrite=True)
    left = sorted(file.name for file in tmp_path.iterdir())
    assert left == ["can-trace.log", "notes.txt", "run-mine.mcap"]
