import numpy as np
import pytest
from mcap.reader import make_reader
from recorded import LINES, record
from same import same

from scan3d_twin.core.errors import FileError
from scan3d_twin.recording.load import find_session_file, load_session, read_lines
from scan3d_twin.recording.mcap.file import FLUSH_PERIOD
from scan3d_twin.recording.mcap.recovering_reader import is_finished, read_contents


@pytest.fixture(scope="module")
def killed(session, tmp_path_factory):
    """What is on the disk when a run is killed, as bytes."""
    folder = tmp_path_factory.mktemp("killed")
    record(folder, session, finish=False)
    return (folder / "session.mcap.part").read_bytes()


def everything(path):
    """Return all records that can be read from the file."""
    return list(read_contents(path))


def test_a_cut_at_any_byte_costs_what_comes_after_it_and_no_more(tmp_path, killed, session):
    path, rng = tmp_path / "session.mcap.part", np.random.default_rng(0)
    before, views = 0, 0
    for size in [*np.sort(rng.integers(8, len(killed), 40)), len(killed)]:
        path.write_bytes(killed[:size])
        count = len(everything(path))
        assert count >= before
        before = count
        try:
            recorded = load_session(path)
        except FileError:
            assert views == 0
            continue
        assert len(recorded.session.views) >= views
        views = len(recorded.session.views)
        assert same(recorded.session.views, session.views[:views])
        assert recorded.session.stop_reason == ""
    assert views == 2


def test_a_cut_costs_less_than_a_flush_period_of_lines(tmp_path, killed):
    path = tmp_path / "session.mcap.part"
    path.write_bytes(killed)
    stamps = [line.stamp for line in read_lines(path)]
    assert len(stamps) == 2 * LINES
    path.write_bytes(killed[:-1])
    left = [line.stamp for line in read_lines(path)]
    assert stamps[len(left) - 1] > stamps[-1] - FLUSH_PERIOD


def largest_chunk(path):
    """Return a place in the middle of a chunk of a finished file; a view is in it."""
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    chunk = max(chunks, key=lambda each: each.compressed_size)
    return chunk.chunk_start_offset + chunk.chunk_length // 2


def test_a_flipped_bit_costs_what_comes_after_it(tmp_path, killed, session):
    """A bad block is what a power cut can leave."""
    place = largest_chunk(record(tmp_path, session).path)
    path = tmp_path / "session.mcap.part"
    broken = bytearray(killed)
    broken[place] ^= 0x10
    path.write_bytes(killed)
    sound = everything(path)
    path.write_bytes(broken)
    kept = everything(path)
    assert 0 < len(kept) < len(sound)
    assert kept == sound[: len(kept)]


def test_zeros_where_the_end_was(tmp_path, killed):
    path = tmp_path / "session.mcap.part"
    path.write_bytes(killed[:-5000] + bytes(5000))
    assert load_session(path).session.views


def test_a_damaged_finished_file_says_how_to_save_the_rest(tmp_path, session):
    path = record(tmp_path, session).path
    data = bytearray(path.read_bytes())
    data[largest_chunk(path)] ^= 0x10
    path.write_bytes(data)
    assert is_finished(path)
    with pytest.raises(FileError, match=r"is damaged .*; save what is left: twin session recover"):
        load_session(path)


@pytest.mark.parametrize("content", [b"", b"ply\n", b"\x89MCAP0\r"], ids=str)
def test_what_is_no_session_file(tmp_path, content):
    path = tmp_path / "session.mcap"
    path.write_bytes(content)
    with pytest.raises(FileError, match="is no session file"):
        load_session(path)


def test_a_folder_without_a_session(tmp_path):
    with pytest.raises(FileError, match=r"no session in .*: a run's folder holds a session\.mcap"):
        find_session_file(tmp_path)
    with pytest.raises(FileError, match="cannot read"):
        is_finished(tmp_path / "none")
