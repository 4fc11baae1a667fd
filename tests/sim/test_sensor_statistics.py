"""The benchmark that compares the twin with a log: its statistics, its room, its verdict."""

import importlib
import math
import os
from pathlib import Path

import numpy as np
import pytest

from scan3d_twin.sim.config import LidarModelConfig
from scan3d_twin.sim.lidar.config import IDEAL_LIDAR, UNFILTERED_LIDAR

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
FOLDER = os.environ.get("SCAN3D_TWIN_CAPTURES", "")
LINES, STEPS = 30, 682


@pytest.fixture(scope="module")
def log():
    """The module of the benchmark that reads the log and rebuilds its room."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield importlib.import_module("sensor_log")


@pytest.fixture(scope="module")
def statistics(log):
    """The module of the benchmark that compares."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield importlib.import_module("sensor_statistics")


def square_room(log, half=1.5, noise=0.0):
    """Return lines of a sensor in the middle of a square room (LINES, 682) [mm]."""
    across = np.maximum(np.abs(np.cos(log.ANGLES)), np.abs(np.sin(log.ANGLES)))
    drawn = noise * np.random.default_rng(0).standard_normal((LINES, STEPS))
    return np.rint(1000 * (half / across + drawn)).astype(int)


def test_shares_are_counted(statistics):
    valid = 12
    line = [0, 7, 0, 500, 500, 500, 0, 800, 0, 805, 1000, 1200, 1200, 1200, 1200, 1200, 1200]
    readings = np.array([line, line])
    readings[1, -1] = 0
    shares = {
        name: (top.sum(), under.sum())
        for name, (top, under) in statistics.count_shares(readings, readings >= 20).items()
    }
    assert shares["mixed pixels"] == (2, 2 * valid - 1)  # 1000 between 805 and 1200
    assert shares["isolated dropouts"] == (2, 2 * valid - 1)  # between 800 and 805
    assert shares["equal threes"] == (2, 2)
    assert shares["flicker"] == (1, len(line))
    assert shares["code 7"] == (2, 2 * len(line))
    assert shares["code 0"] == (9, 2 * len(line))


def test_walls_are_measured_by_range_and_incidence(log, statistics):
    readings = square_room(log, noise=0.004)
    steps = statistics.WallSteps.of(readings)
    front, oblique = np.argmin(np.abs(log.ANGLES)), np.argmin(np.abs(log.ANGLES - 0.6))
    assert steps.incidence[front] == pytest.approx(0, abs=3)
    assert steps.incidence[oblique] == pytest.approx(math.degrees(0.6), abs=3)
    blocks = statistics.make_blocks(0, readings, steps)
    for name in ("sd 1-2 m 0-30 deg", "sd 1-2 m 30-60 deg"):
        assert statistics.evaluate(name, blocks) == pytest.approx(4.0, rel=0.05)
    for lag in (1, 2, 3):  # white noise
        assert abs(statistics.evaluate(f"correlation at lag {lag}", blocks)) < 0.03
    low, high = statistics.bootstrap("sd 1-2 m 0-30 deg", blocks, np.random.default_rng(0))
    assert 3.7 < low < 4.0 < high < 4.3


def test_the_rebuilt_room_is_that_of_the_log(log, statistics):
    """An exact sensor in it reads what the log's sensor read, but at the ends of walls."""
    readings = square_room(log, noise=0.002)
    stretch = log.Stretch(readings, readings)
    walls = log.fit_walls(stretch)
    seen = statistics.read_twin(stretch, walls, IDEAL_LIDAR, 0)
    off = np.abs(seen - square_room(log))
    assert np.quantile(off, 0.95) <= 8
    assert 4 <= len(walls) < 80


def test_directions_without_readings_stay_so(log, statistics):
    readings = square_room(log)
    readings[:, 100:200], readings[:, 300:340] = 0, 6
    stretch = log.Stretch(readings, readings)
    seen = statistics.read_twin(stretch, log.fit_walls(stretch), LidarModelConfig(), 0)
    inner = seen[:, 105:195]
    assert np.mean(inner < 20) > 0.95
    assert 0.005 < np.mean(inner == 7) < 0.05  # single steps are detected now and then
    assert np.mean(seen[:, 305:335] == 6) > 0.95


@pytest.mark.parametrize(
    ("kind", "interval", "twin", "verdict"),
    [
        ("SMOOTH", (0.8, 1.2), 1.1, "inside"),
        ("SMOOTH", (0.8, 1.2), 1.3, "outside"),
        ("EDGES", (0.8, 1.2), 1.9, "inside"),
        ("EDGES", (0.8, 1.2), 2.1, "outside"),
        ("EDGES", (0.8, 1.2), 0.45, "outside"),
        ("SMOOTH", (0.8, 1.7), 1.0, "not decided"),
        ("EDGES", (0.0, 1.2), 1.0, "not decided"),
        ("SMOOTH", (math.nan, math.nan), 1.0, "not decided"),
    ],
)
def test_the_verdict(statistics, kind, interval, twin, verdict):
    row = statistics.Row("name", getattr(statistics, kind), 1.0, *interval, twin)
    assert row.verdict == verdict


@pytest.fixture(scope="module")
def real():
    """The path of the real log."""
    path = Path(FOLDER) / "urg04lx_standing" / "exp1.dat"
    if not FOLDER or not path.is_file():
        pytest.skip("SCAN3D_TWIN_CAPTURES names no folder with urg04lx_standing/exp1.dat")
    return path


def test_the_twin_is_as_noisy_as_the_real_sensor(statistics, real):
    rows = {row.name: row for row in statistics.compare(real, LidarModelConfig(), 4)}
    assert not [name for name, row in rows.items() if row.verdict == "outside"]
    decided = {name for name, row in rows.items() if row.verdict == "inside"}
    assert decided >= {
        "sd 1-2 m 0-30 deg", "sd 1-2 m 30-60 deg", "sd 2-3 m 30-60 deg", "sd 3-4 m 0-30 deg",
        "equal neighbours", "correlation at lag 1", "correlation at lag 2", "revolution",
        "equal threes", "flicker", "code 0", "code 7",
    }  # fmt: skip


def test_the_noise_assumed_before_was_not(statistics, real):
    rows = {row.name: row for row in statistics.compare(real, UNFILTERED_LIDAR, 2)}
    outside = {name for name, row in rows.items() if row.verdict == "outside"}
    assert outside >= {"sd 1-2 m 0-30 deg", "correlation at lag 1", "equal threes", "revolution"}
