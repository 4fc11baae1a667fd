"""`twin session` and `twin replay` on a finished run."""

import json
import re
import shutil
from pathlib import Path

import jsonschema
import pytest
from mcap.reader import make_reader

from scan3d_twin.recording.load import load_session
from scan3d_twin.recording.names import RECORDS
from scan3d_twin.run.report import report_schema


@pytest.fixture
def run(finished, tmp_path):
    """A copy of the finished run that may be changed."""
    return Path(shutil.copytree(finished[0], tmp_path / "run"))


def files(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in ("report.html", "report.json")
    }


def cut(run):
    """Make a run look as a kill leaves it."""
    data = (run / "session.mcap").read_bytes()
    (run / "session.mcap").unlink()
    (run / "session.mcap.part").write_bytes(data[: len(data) - 20_000])


def test_info_tells_what_is_there(finished, twin):
    folder, report = finished
    found = json.loads(twin("session", "info", folder, "--json").out)
    assert (found["state"], found["name"]) == ("finished", "three_boxes")
    assert len(found["views"]) == report["views"]
    assert found["lines"] > sum(view["lines"] for view in found["views"])
    assert found["versions"]["numpy"]
    assert found["duration_s"] == report["sim_time_s"]
    assert found["path_m"] == pytest.approx(report["path_m"], abs=0.001)
    words = twin("session", "info", folder).out
    assert "finished" in words
    assert words.count("\nview ") == 2
    first, second = words.splitlines()[-2:]
    assert first.startswith("view 0: ")
    assert first.endswith(" points, defines the frame world")
    assert second.endswith(" points, registered")


def test_a_killed_run_can_be_looked_at_and_made_whole(run, twin):
    cut(run)
    assert json.loads(twin("session", "info", run, "--json").out)["state"] == "killed"
    before = (run / "session.mcap.part").read_bytes()
    result = json.loads(twin("session", "recover", run, "--json").out)
    assert result == {
        "path": str(run / "session.mcap"),
        "kept": str(run / "session.1.mcap.part"),
        "views_before": 2,
        "views_after": 2,
        "views_recorded": 2,
        "lost_messages": 0,
        "lost_settings": False,
    }
    assert (run / "session.1.mcap.part").read_bytes() == before
    assert json.loads(twin("session", "info", run, "--json").out)["state"] == "finished"
    assert "nothing to do" in twin("session", "recover", run).out


def test_a_view_in_a_damaged_part_is_the_only_loss_and_is_told(run, twin):
    """The largest chunk of records alone is that of a view; messages of the others are counted."""
    path = run / "session.mcap"
    data = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    records = [
        each
        for each in summary.chunk_indexes
        if {topics[number] for number in each.message_index_offsets} == {RECORDS}
    ]
    largest = max(records, key=lambda each: each.compressed_size)
    data[largest.chunk_start_offset + largest.chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    result = twin("session", "recover", run)
    assert result.code == 3
    assert "0 views before, 1 after, 1 message lost" in result.out
    assert "1 of 2 recorded views were in the damaged part and are lost" in result.err
    assert json.loads(twin("session", "info", run, "--json").out)["state"] == "finished"
    assert twin("session", "recover", run).code == 0


def test_info_tells_of_a_run_that_was_killed_before_its_first_view(run, twin):
    data = (run / "session.mcap").read_bytes()
    (run / "session.mcap").unlink()
    (run / "session.mcap.part").write_bytes(data[:40_000])
    found = json.loads(twin("session", "info", run, "--json").out)
    assert (found["state"], found["name"], found["views"]) == ("killed", "three_boxes", [])
    assert found["planner"] == "fisher"
    assert found["duration_s"] > 0
    result = twin("session", "info", run)
    assert result.code == 0
    assert "0 views" in result.out
    assert "no view was finished" in result.out


def test_a_dropped_view_is_gone_and_comes_back(run, twin):
    before = files(run)
    result = twin("session", "drop-view", run, 1, "--json")
    report = json.loads(result.out)
    jsonschema.validate(report, report_schema())
    assert (result.code, report["views"], report["registration"]) == (0, 1, [])
    assert report["coverage_20mm"] is not None
    assert len(load_session(run).session.views) == 1
    assert not (run / "views" / "001.npz").exists()
    assert len((run / "model.ply").read_bytes()) < len(before["model.ply"])
    result = twin("session", "undo", run)
    assert result.code == 0
    assert "2 views" in result.out
    after = files(run)
    assert {name: after[name] for name in before} == before


def test_a_run_from_elsewhere_cannot_change_files_of_mine(run, tmp_path, twin):
    """Its folder of views leads to another folder, and a backup's name to a file."""
    mine = tmp_path / "mine"
    mine.mkdir()
    for k in range(3):
        (mine / f"{k:03d}.npz").write_text("precious")
    shutil.rmtree(run / "views")
    (run / "views").symlink_to(mine)
    (run / "session.1.mcap").symlink_to(tmp_path / "to_be_made")
    assert "views is a link to another place" in fails_late(twin, 3, "session", "drop-view", run, 1)
    assert [path.read_text() for path in sorted(mine.iterdir())] == ["precious"] * 3
    assert not (tmp_path / "to_be_made").exists()


def fails_late(twin, code, *arguments):
    """Call the program, expect an error after its progress, and return it."""
    result = twin(*arguments)
    assert result.code == code
    assert "Traceback" not in result.err
    return result.err


def test_there_is_no_such_view_to_drop(run, fails):
    assert "there is no view 7: the run has 2" in fails(2, "session", "drop-view", run, 7)


def test_nothing_to_take_back(run, fails):
    assert "nothing to take back" in fails(3, "session", "undo", run)


@pytest.mark.parametrize("command", ["info", "recover", "undo"])
def test_a_folder_without_a_session(tmp_path, fails, command):
    assert "no session in" in fails(3, "session", command, tmp_path)


def test_a_replay_with_the_recorded_options_is_the_same_bit_by_bit(finished, twin):
    found = json.loads(twin("replay", finished[0], "--json").out)
    assert found["identical"]
    assert found["options"] == {}
    assert [row["moved_mm"] for row in found["views"]] == [0.0, 0.0]
    assert "identical, bit by bit" in twin("replay", finished[0]).out


def test_a_replay_shows_each_plan_at_the_view_it_led_to_as_the_run_did(finished, twin):
    folder, report = finished
    (planned,) = report["registration"]
    words = twin("replay", folder).out
    header, first, second, last, verdict = words.splitlines()
    titles = ["overlap was", "overlap now", "predicted was", "predicted now"]
    assert re.split(r"  +", header.strip()) == ["view", "moved", "turned", *titles]
    overlap, error = f"{planned['overlap']:.0%}", f"{planned['predicted_rmse_mm']:.1f} mm"
    cells = [re.split(r"  +", line.strip()) for line in (first, second)]
    assert cells[0] == ["0", "0 mm", "0 deg", "-", "-", "-", "-"]
    assert cells[1] == ["1", "0 mm", "0 deg", overlap, overlap, error, error]
    assert last == f"plan after the last view: none ({report['stop_reason']})"
    assert verdict == "all poses and plans are identical, bit by bit"


def test_a_replay_names_the_plan_after_the_last_view_if_only_that_differs(finished, twin):
    _, report = finished
    Path("more.toml").write_text("max_views = 3\n")
    words = twin("replay", finished[0], "--config", "more.toml").out
    *_, last, verdict = words.splitlines()
    recorded = f"none ({report['stop_reason']})"
    assert last.startswith(f"plan after the last view: was {recorded}; now ")
    assert recorded not in last.partition("; now ")[2]
    assert verdict == "0 of 2 views differ; the plan after the last view differs"


def test_a_replay_with_other_options_tells_what_comes_out_otherwise(finished, twin):
    arguments = ["--epsilon", "1", "--registration.engine", "icp"]
    result = twin("replay", finished[0], *arguments, "--json")
    found = json.loads(result.out)
    assert not found["identical"]
    assert found["options"] == {
        "planning.epsilon": [0.1, 0.001],
        "registration.engine": ["grid", "icp"],
    }
    assert [row["identical"] for row in found["views"]] == [True, False]
    assert found["views"][0]["moved_mm"] == 0.0
    assert found["views"][1]["moved_mm"] > 0.0
    assert "replayed view 1: 2 of 2 done" in result.err
    words = twin("replay", finished[0], *arguments).out
    assert "planning.epsilon: 0.1 recorded, 0.001 now" in words
    assert "1 of 2 views differ; the final poses differ" in words


def test_a_replay_needs_no_end(run, twin):
    cut(run)
    assert json.loads(twin("replay", run, "--json").out)["identical"]


def test_a_replay_of_nothing(tmp_path, fails):
    assert "no session in" in fails(3, "replay", tmp_path)
