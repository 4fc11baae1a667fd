"""A film of a recorded run."""

from dataclasses import replace

import av
import numpy as np
import pytest
from full_disk import full_disk
from PIL import Image
from recorded import record
from short_runs import COARSE_OPTIONS

import scan3d_twin as s3d
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.recording.load import load_session
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.recovering_reader import read_contents
from scan3d_twin.recording.mcap.rewrite import copy_record
from scan3d_twin.recording.names import ODOMETRY
from scan3d_twin.run.settings import REAL_SCENE
from scan3d_twin.viz.film import HEIGHT, STRIP, WIDTH, draw_frames, prepare_film
from scan3d_twin.viz.film_file import film_kind, write_film

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """What the film of a run of two views is made of."""
    folder = tmp_path_factory.mktemp("film") / "run"
    s3d.run_sim("three_boxes", seed=1, options={"max_views": 2, **COARSE_OPTIONS}, out=folder)
    return prepare_film(load_session(folder))


@pytest.fixture(scope="module")
def frames(film):
    """Its frames, few of them."""
    return list(draw_frames(film, 8))


def test_the_robot_drives_and_the_cloud_grows(film, frames):
    assert {frame.shape for frame in frames} == {(HEIGHT + STRIP, WIDTH, 3)}
    dark = [_middle(frame[:HEIGHT].max(axis=-1) < 70) for frame in frames]
    assert np.hypot(*(dark[-1] - dark[0])) > 30
    grown = [int((frame[:HEIGHT] != film.scene).any(axis=-1).sum()) for frame in frames]
    assert grown[0] < 0.3 * grown[-1]
    assert film.stamps[0] > 0.0
    assert np.all(np.diff(film.stamps) >= 0)


def test_points_lie_on_the_scene_and_not_beside_it(film):
    """Most points are where the picture shows a surface: the model was laid on the target."""
    column, row, ahead = film.eye.project(film.points, WIDTH, HEIGHT)
    inside = (ahead > 0.1) & (row >= 0) & (row < HEIGHT) & (column >= 0) & (column < WIDTH)
    shown = film.depth[row[inside].astype(int), column[inside].astype(int)]
    off = np.abs(shown - ahead[inside])
    assert np.mean(off < 0.05) > 0.4  # the others are hidden behind the boxes
    assert np.mean(ahead[inside] < shown - 0.05) < 0.05


def test_errors_appear_with_their_view(film, frames):
    assert len(film.errors) == 1
    when, predicted, realised = film.errors[0]
    assert film.end * 0.5 < when <= film.end
    assert 0.0 < realised < predicted < 10.0
    coloured = [np.ptp(frame[HEIGHT:, 400:600].astype(int), axis=-1).max() for frame in frames]
    assert coloured[0] == coloured[3]
    strips = [frame[HEIGHT:, 380:] for frame in frames]
    assert np.array_equal(strips[0], strips[3])
    assert not np.array_equal(strips[0], strips[-1])


def test_it_is_written_as_mp4_and_as_gif(frames, tmp_path):
    write_film(tmp_path / "a.mp4", frames, 5)
    with av.open(str(tmp_path / "a.mp4")) as file:
        stream = file.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (WIDTH, HEIGHT + STRIP, 5)
        assert sum(1 for _ in file.decode(stream)) == len(frames)
    header = (tmp_path / "a.mp4").read_bytes()
    created = header.index(b"mvhd") + 8
    assert header[created : created + 4] == bytes(4)  # no time of writing
    write_film(tmp_path / "b.mp4", frames, 5)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    write_film(tmp_path / "a.gif", frames, 5)
    assert durations(tmp_path / "a.gif") == [200] * len(frames)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.mp4", "b.mp4"]


@pytest.mark.parametrize("name", ["a.mp4", "a.gif"])
def test_nothing_is_left_of_a_film_that_does_not_fit(frames, tmp_path, name):
    with full_disk(4096), pytest.raises(FileError, match=r"^cannot write \S+: .{5,80}$"):
        write_film(tmp_path / name, frames, 5)
    assert list(tmp_path.iterdir()) == []


def durations(path):
    """Return the time that each picture of a GIF is shown [ms]."""
    with Image.open(path) as gif:
        return [gif.seek(k) or gif.info["duration"] for k in range(gif.n_frames)]


@pytest.mark.parametrize("fps", [1, 15, 24, 30, 50])
def test_a_gif_is_as_long_as_asked(tmp_path, fps):
    """Its durations are whole hundredths of a second, which no third of one may add up to."""
    count = 2 * fps
    pictures = [np.full((4, 4, 3), 2 * k, dtype=np.uint8) for k in range(count)]
    write_film(tmp_path / "a.gif", pictures, fps)
    shown = durations(tmp_path / "a.gif")
    assert (len(shown), sum(shown)) == (count, 2000)
    assert min(shown) >= 20
    np.testing.assert_allclose(np.cumsum(shown), 1000 / fps * np.arange(1, count + 1), atol=5.0)


def test_a_gif_of_pictures_that_browsers_slow_down_is_refused(tmp_path):
    assert film_kind(tmp_path / "a.mp4", 60) == "mp4"
    with pytest.raises(ConfigError, match="50 pictures a second at most, got --fps 60"):
        film_kind(tmp_path / "a.gif", 60)


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"a film ends in \.mp4 or \.gif, got a\.avi"):
        film_kind(tmp_path / "a.avi", 15)


def _middle(mask):
    """Return row and column of the middle of what ``mask`` shows."""
    return np.array([each.mean() for each in np.nonzero(mask)])


def test_a_run_without_odometry_stands_at_its_viewpoints(session, tmp_path):
    path = record(tmp_path, session).path
    run = load_session(path)
    settings = replace(run.settings, run=replace(run.settings.run, scene=REAL_SCENE))
    copy = McapFile(tmp_path / "bare.mcap", lambda: 0.0)
    for each in read_contents(path):
        if getattr(each, "topic", "") != ODOMETRY:
            copy_record(each, copy)
    copy.finish()
    bare = load_session(tmp_path / "bare.mcap")
    film = prepare_film(replace(bare, settings=settings))
    assert film.end == session.views[-1].image.stamps.max()
    x_y = [(view.T_world_scan.x, view.T_world_scan.y) for view in session.views]
    np.testing.assert_allclose(film.track[:, 1:3], x_y)
    assert len(list(draw_frames(film, 2))) == 2


def test_a_real_run_is_shown_without_its_surroundings(tmp_path):
    s3d.run_sim("three_boxes", options={"max_views": 1, **COARSE_OPTIONS}, out=tmp_path / "run")
    run = load_session(tmp_path / "run")
    settings = replace(run.settings, run=replace(run.settings.run, scene=REAL_SCENE))
    film = prepare_film(replace(run, settings=settings))
    last = list(draw_frames(film, 2))[-1]
    assert 0.02 < (last[:HEIGHT] != film.scene).any(axis=-1).mean() < 0.9
