from deploy.runs.run_folder import new_folder


def test_folder_that_is_used_again_keeps_no_recording_of_the_run_before(tmp_path):
    for name in ("run.mcap", "run-2.mcap", "run-3.partial.mcap", "can-2.log", "notes.txt"):
        (tmp_path / name).write_text("old")
    new_folder("again", tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]
