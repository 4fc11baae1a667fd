"""The twin's scan statistics beside those of a real URG-04LX.

The capture is one scan of an office, so it gives shares with wide intervals. Nothing is fitted to
it: the test asks only that the twin is no further off than another room explains.
"""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from scan_statistics import Share, statistics

from scan3d_twin.core.types import VALID
from scan3d_twin.sim.config import LidarModelConfig, TwinConfig
from scan3d_twin.sim.robot import open_sim

FOLDER = os.environ.get("SCAN3D_TWIN_CAPTURES", "")


def capture():
    """Return the one full scan of the capture (1, 682) [mm]: hokuyoaist's log of a URG-04LX."""
    path = Path(FOLDER) / "urg04lx_capture" / "example_urg_04lx.logr"
    if not FOLDER or not path.is_file():
        path = Path(FOLDER) / "example_urg_04lx.logr"
    if not FOLDER or not path.is_file():
        pytest.skip("SCAN3D_TWIN_CAPTURES names no folder with example_urg_04lx.logr")
    log, received, at = path.read_bytes(), b"", 0
    while at + 12 <= len(log):  # seconds, microseconds, length; big-endian
        length = int.from_bytes(log[at + 8 : at + 12], "big")
        received += log[at + 12 : at + 12 + length]
        at += 12 + length
    reply = received[received.index(b"GD0044072501") :]
    lines = reply[: reply.index(b"\n\n")].split(b"\n")[3:]  # after echo, status and time stamp
    body = np.frombuffer(b"".join(line[:-1] for line in lines), np.uint8).reshape(-1, 3) - 0x30
    return (body.astype(int) @ [4096, 64, 1])[None]


def twin(scene):
    """Return lines of the twin with wide beams (m, 341) within 60 deg of level [mm]."""
    config = TwinConfig(lidar=LidarModelConfig(sub_rays=5))
    with open_sim(scene, 0, config) as (robot, _):
        robot.base.set_velocity(0.0, math.radians(20))
        lines = [robot.lidar.read_line(1.0) for _ in range(100)]
    rows = [np.where(x.codes == VALID, np.nan_to_num(x.ranges) * 1000, x.codes) for x in lines]
    return np.rint(np.array(rows)[:, 170:511]).astype(int)


def test_a_share_has_its_binomial_interval():
    low, high = Share(10, 100).interval()
    assert (low, high) == pytest.approx((0.0552, 0.1744), abs=1e-4)  # Wilson 1927


def test_shares_are_counted():
    line = np.array([[0, 7, 500, 500, 500, 800, 1200, 0, 1200, 1200]])
    shares = statistics(line)
    assert (shares["invalid"].count, shares["code 7"].count) == (3, 1)
    assert (shares["equal neighbours"].count, shares["equal neighbours"].total) == (3, 5)
    assert shares["in runs of 3 or more"].count == 3
    assert shares["mixed pixels"].count == 1


@pytest.mark.parametrize("scene", ["living_room", "clutter_100"])
def test_the_twin_scans_like_the_real_sensor(scene):
    real, ours = statistics(capture()), statistics(twin(scene))
    for name, factor in (("invalid", 2), ("equal neighbours", 2), ("mixed pixels", 3)):
        low, high = real[name].interval()
        assert low / factor < ours[name].value < high * factor, name
    assert ours["code 0"].value > 0.8 * ours["invalid"].value
    assert ours["code 7"].count > 0
    assert ours["code 10"].count > 0
