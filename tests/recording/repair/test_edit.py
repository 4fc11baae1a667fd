import errno
import os
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from full_disk import full_disk
from paper import paper_alignment, paper_config
from recorded import line, make_robot, record
from same import same

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2
from scan3d_twin.recording.mcap.recovering_reader import is_finished
from scan3d_twin.recording.mcap.rewrite import back_up
from scan3d_twin.recording.recorder import Recorder
from scan3d_twin.recording.repair.edit import drop_view, remove_view, undo_last_change
from scan3d_twin.recording.repair.recover import recover_session

PLACES = (0.2, 0.0, -0.2)


@pytest.fixture(scope="module")
def three():
    """Three views, the second placed wrongly; the noise of the real lidar."""
    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session, rng = Session(paper_config(), 7, hint, np.array([-1.0, 0.0])), np.random.default_rng(0)
    for y in PLACES:
        session = integrate(session, synthetic.observe(Pose2(-0.4, y, 0.0), sigma=0.005, rng=rng))
        session = session.with_plan(Plan(Pose2(-0.4, y, 0.0), 0.8, 0.01, False, (), "a plan"))
    wrong = replace(session.views[1], T_world_scan=Pose2(0.0, 1.0, 0.5))
    views = (session.views[0], wrong, session.views[2])
    return replace(session, views=views).with_stop_reason("enough")


@pytest.mark.parametrize("mode", ["off", "loop_closure"])
def test_the_rest_is_placed_without_the_bad_view(three, mode):
    config = replace(three.config, alignment=paper_alignment(mode=mode))
    rest = remove_view(replace(three, config=config), 1)
    assert len(rest.views) == len(rest.plans) == 2
    for view, y in zip(rest.views, (PLACES[0], PLACES[2]), strict=True):
        assert view.T_world_scan.distance(Pose2(-0.4, y, 0.0)) < 0.01
        assert view.observation.T_odom_scan.y == y


@pytest.mark.parametrize(("index", "words"), [(3, "there is no view 3"), (-1, "there is no view")])
def test_there_is_no_such_view(three, index, words):
    with pytest.raises(ConfigError, match=words):
        remove_view(three, index)


def test_one_view_must_stay(three):
    with pytest.raises(ConfigError, match="only view"):
        remove_view(replace(three, views=three.views[:1]), 0)


def test_a_change_is_recorded_and_taken_back(three, tmp_path):
    record(tmp_path, three)
    dropped = drop_view(tmp_path, 1, lambda: 0.0)
    assert same(dropped.session, remove_view(three, 1))
    assert dropped.session.stop_reason == "enough"
    assert same(undo_last_change(tmp_path).session, three)
    assert same(undo_last_change(tmp_path).session, dropped.session)
    assert same(undo_last_change(tmp_path).session, three)


def test_an_unfinished_session_is_changed_too_and_comes_back_unfinished(three, tmp_path):
    record(tmp_path, three, finish=False)
    before = (tmp_path / "session.mcap.part").read_bytes()
    assert drop_view(tmp_path, 2, lambda: 0.0).finished
    assert not undo_last_change(tmp_path).finished
    assert (tmp_path / "session.mcap.part").read_bytes() == before


def test_a_run_in_progress_is_left_alone(three, tmp_path):
    record(tmp_path, three, finish=False)
    with (tmp_path / "session.mcap.part").open("rb") as stream:
        import fcntl

        fcntl.flock(stream, fcntl.LOCK_EX)
        with pytest.raises(FileError, match="a running program is writing to"):
            drop_view(tmp_path, 1, lambda: 0.0)
    assert [path.name for path in tmp_path.iterdir()] == ["session.mcap.part"]


def test_what_a_robot_said_before_it_failed_can_be_made_whole(tmp_path):
    """No view was finished, and so there is nothing to go on from; others can read it still."""
    recorder = Recorder(tmp_path, lambda: 0.0, {})
    recorder.attach(make_robot())
    recorder.on_line(line(0.5))
    recorder.abandon(keep=True)
    assert recover_session(tmp_path, lambda: 0.0).backup == tmp_path / "session.1.mcap.part"
    assert is_finished(tmp_path / "session.mcap")
    assert recover_session(tmp_path, lambda: 0.0).backup is None


@pytest.mark.parametrize("name", ["session.1.mcap", "session.2.mcap.part", "copy.mcap"])
def test_a_backup_is_not_put_in_the_place_of_the_session(three, tmp_path, name):
    """Before, what replaced the session was made of the backup, and the session was gone."""
    kept = record(tmp_path, three).path.read_bytes()
    backup = tmp_path / name
    backup.write_bytes(kept)
    with pytest.raises(FileError, match=f"{name} is a backup or a copy.*name its folder"):
        drop_view(backup, 1, lambda: 0.0)
    backup.write_bytes(kept[:-100])
    with pytest.raises(FileError, match=f"{name} is a backup or a copy.*name its folder"):
        recover_session(backup, lambda: 0.0)
    assert (tmp_path / "session.mcap").read_bytes() == kept
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted(["session.mcap", name])


def test_a_session_that_an_unfinished_file_continues_is_not_put_in_its_place(three, tmp_path):
    kept = record(tmp_path, three).path.read_bytes()
    part = tmp_path / "session.mcap.part"
    part.write_bytes(kept[:-100])
    with pytest.raises(FileError, match=r"session\.mcap\.part continues .*name their folder"):
        drop_view(tmp_path / "session.mcap", 1, lambda: 0.0)
    assert part.read_bytes() == kept[:-100]
    assert (tmp_path / "session.mcap").read_bytes() == kept


def test_a_full_disk_leaves_the_session_as_it_was(three, tmp_path):
    path = record(tmp_path, three).path
    before = path.read_bytes()
    words = r"cannot record to .*; .*session\.mcap is as it was: free disk space and try again"
    with full_disk(100_000), pytest.raises(FileError, match=words):
        drop_view(tmp_path, 1, lambda: 0.0)
    assert [each.name for each in tmp_path.iterdir()] == ["session.mcap"]
    assert path.read_bytes() == before


def test_a_backup_that_does_not_fit_is_not_left(three, tmp_path, monkeypatch):
    """On a file system without links, where the backup is a copy."""

    def no_links(*_):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    path = record(tmp_path, three).path
    monkeypatch.setattr("scan3d_twin.recording.mcap.rewrite.os.link", no_links)
    with full_disk(100_000), pytest.raises(FileError, match=r"cannot write .*session\.1\.mcap"):
        back_up(path)
    assert [each.name for each in tmp_path.iterdir()] == ["session.mcap"]
    assert back_up(path).read_bytes() == path.read_bytes()
