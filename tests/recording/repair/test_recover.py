import random

import numpy as np
import pytest
import synthetic
from mcap.reader import make_reader
from paper import paper_config
from recorded import record
from same import same

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.errors import FileError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2
from scan3d_twin.recording.load import decode_record, load_session, read_lines
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.recovering_reader import is_sound, read_contents
from scan3d_twin.recording.mcap.rewrite import copy_record, is_mark
from scan3d_twin.recording.repair.recover import UNKNOWN, recover_session
from scan3d_twin.recording.session_log import mark_lengths

SEED, FAULTS = 4, 4
"""Single faults of each kind; benchmarks/fuzz.py takes hundreds."""


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """The session file of three views, as bytes, its session, and the places of its chunks."""
    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session, rng = Session(paper_config(), 7, hint, np.array([-1.0, 0.0])), np.random.default_rng(0)
    for y in (0.2, 0.0, -0.2):
        session = integrate(session, synthetic.observe(Pose2(-0.4, y, 0.0), sigma=0.005, rng=rng))
        session = session.with_plan(Plan(Pose2(-0.4, y, 0.0), 0.8, 0.01, False, (), "a plan"))
    session = session.with_stop_reason("enough")
    path = record(tmp_path_factory.mktemp("three"), session).path
    with path.open("rb") as stream:
        index = make_reader(stream).get_summary().chunk_indexes
    places = [
        (c.chunk_start_offset, c.chunk_start_offset + c.chunk_length + c.message_index_length)
        for c in index
    ]
    return path.read_bytes(), session, places


def readable(folder):
    try:
        return len(load_session(folder).session.views)
    except FileError:
        return 0


def write(folder, data):
    (folder / "session.mcap").write_bytes(data)
    return folder / "session.mcap"


def flipped(data, place):
    changed = bytearray(data)
    changed[place] ^= 0x10
    return bytes(changed)


def swapped(data, first, second):
    """Return the file with two of its chunks in each other's place."""
    (a, b), (c, d) = first, second
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


@pytest.mark.parametrize("kind", ["flip", "cut", "swap"])
def test_no_single_fault_makes_a_repair_lose_a_view(three, tmp_path, kind):
    data, session, places = three
    draw = random.Random(f"{SEED} {kind}")
    for _ in range(FAULTS):
        if kind == "flip":
            damaged = flipped(data, draw.randrange(8, len(data)))
        elif kind == "cut":
            damaged = data[: draw.randrange(len(data) // 2, len(data))]
        else:
            damaged = swapped(data, *sorted(draw.sample(places, 2)))
        for path in tmp_path.iterdir():
            path.unlink()
        write(tmp_path, damaged)
        before = readable(tmp_path)
        found = recover_session(tmp_path, lambda: 0.0)
        assert found.before == before
        after = load_session(tmp_path).session
        assert len(after.views) == found.after >= max(before, 3 if kind == "swap" else 1)
        if kind == "flip":
            assert found.after >= 2  # at most the damaged chunk is lost, and a view fits into one
        whole = {view.observation.T_odom_scan: view for view in session.views}
        for view in after.views:
            assert same(view.observation, whole[view.observation.T_odom_scan].observation)
            assert view.T_world_scan == whole[view.observation.T_odom_scan].T_world_scan
        assert is_sound(tmp_path / "session.mcap")


def test_what_a_lost_chunk_held_is_counted(three, tmp_path):
    data, _, places = three
    place, _ = places[3]  # lines of the first sweep
    path = write(tmp_path, data)
    lines = sum(1 for _ in read_lines(path))
    write(tmp_path, flipped(data, place + 200))
    assert readable(tmp_path) == 3
    found = recover_session(tmp_path, lambda: 0.0)
    assert (found.before, found.after, found.recorded) == (3, 3, 3)
    assert found.lost_messages > 0
    assert 0 < lines - sum(1 for _ in read_lines(path)) <= found.lost_messages
    assert found.backup.read_bytes() == flipped(data, place + 200)


def test_a_kill_before_a_view_is_marked_loses_no_recorded_view(three, tmp_path):
    """Its records are there without the mark that finishes it: nothing was damaged."""
    data, *_ = three
    contents = list(read_contents(write(tmp_path, data)))
    marks = [k for k, each in enumerate(contents) if is_mark(each)]
    second = next(k for k in marks if marked_views(contents[k]) == 2)
    (tmp_path / "session.mcap").unlink()
    file = McapFile(tmp_path / "session.mcap.part", lambda: 0.0)
    for each in contents[:second]:
        copy_record(each, file)
    file.flush(0.0)
    file.sink.close()

    found = recover_session(tmp_path, lambda: 0.0)
    assert (found.before, found.after, found.recorded, found.lost_messages) == (1, 1, 1, 0)


def marked_views(each):
    """Return the number of views that a mark counts."""
    return mark_lengths(decode_record(each)[2][0])["views"]


def test_lost_settings_are_said_to_be_lost(three, tmp_path):
    data, session, _ = three
    write(tmp_path, flipped(data, data.index(b"settings") + 3))
    assert readable(tmp_path) == 0
    found = recover_session(tmp_path, lambda: 0.0)
    assert (found.after, found.lost_settings) == (3, True)
    recorded = load_session(tmp_path)
    assert recorded.name == recorded.settings.run.scene == UNKNOWN
    assert recorded.settings.config == session.config


def test_a_file_of_which_nothing_is_left_stays_as_it_is(three, tmp_path):
    data, *_ = three
    path = write(tmp_path, data[:8] + bytes(len(data) - 16) + data[-8:])
    before = path.read_bytes()
    with pytest.raises(FileError, match="nothing is left of"):
        recover_session(tmp_path, lambda: 0.0)
    assert [each.name for each in tmp_path.iterdir()] == ["session.mcap"]
    assert path.read_bytes() == before
