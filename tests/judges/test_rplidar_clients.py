"""Drivers that others wrote read the emulated RPLIDAR, each within its own known faults.

The distance of a point is 1000 mm and 5 mm more per degree: it tells the point's true angle.
"""

import importlib.util
import json
import math
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from virtual import VirtualClock
from virtual_room import TurningLidar

from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import serve
from scan3d_twin.devices.rplidar.codec import WARNING, Health
from scan3d_twin.devices.rplidar.emulated_firmware import RplidarProfile
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.rplidar.model import A1, C1, DENSE, EXPRESS, STANDARD

CODE = 0x1234
SWAPPED = 0x3412
"""The maker's error code, and with its bytes swapped."""


def judge(client, model, link, timeout=20.0):
    """Let ``client`` read the emulated ``model``; return what it read and its angles' errors."""
    if importlib.util.find_spec(client) is None:
        pytest.skip(f"{client} is not installed: uv sync --group judges")
    clock, mode = VirtualClock(), model.modes[link]
    ramp = TurningLidar(clock, model, mode, distances=lambda a: 1000 + 5 * np.degrees(a))
    profile = RplidarProfile(health=Health(WARNING, CODE), mode=mode.number)
    device = RplidarEmulator(ramp, replace(model, spin_up=0.05), profile)
    program = Path(__file__).with_name("read_rplidar.py")
    with closing(PtyPort(Line(device))) as port:
        command = [sys.executable, program, client, port.path, f"{model.baud}", f"{mode.number}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            serve([port], clock, lambda: process.poll() is not None or clock.now() > timeout)
            process.kill()
            (line,) = (each for each in process.stdout if each.startswith('{"model"'))
    read = json.loads(line)
    angles, mm = np.array([point for point in read["points"] if point[1] > 0]).T
    assert len(angles) > 1000
    errors = (angles - (mm - 1000) / 5 + 180) % 360 - 180
    return read, errors


@pytest.mark.parametrize(("model", "link"), [(A1, STANDARD), (A1, EXPRESS), (C1, DENSE)])
def test_the_sdk_of_the_maker_reads_every_kind_of_frame(model, link):
    read, errors = judge("pyrplidarsdk", model, link)
    assert read["model"] == model.model
    assert read["health"] == [WARNING, CODE]
    assert abs(np.median(errors)) < 0.15
    assert np.mean(np.abs(errors) < 0.4) > 0.99


@pytest.mark.parametrize("link", [STANDARD, EXPRESS])
def test_pyrplidar_reads_nodes_and_express_capsules(link):
    read, errors = judge("pyrplidar", A1, link)
    assert read["health"] == [WARNING, SWAPPED]
    assert abs(np.median(errors)) < 0.15
    assert np.mean(np.abs(errors) < 0.4) > 0.99


def test_pyrplidar_swaps_the_bytes_of_a_dense_distance():
    read, _ = judge("pyrplidar", C1, DENSE)
    points = np.array(read["points"])
    swapped = points[:, 1].astype(np.uint16).byteswap()
    errors = (points[:, 0] - (swapped.astype(float) - 1000) / 5 + 180) % 360 - 180
    assert abs(np.median(errors)) < 0.15


def test_roboticia_reads_nodes():
    read, errors = judge("rplidar", A1, STANDARD)
    assert read["model"] == A1.model
    assert read["health"] == ["Warning", SWAPPED]
    assert abs(np.median(errors)) < 0.15
    assert np.mean(np.abs(errors) < 0.4) > 0.99


def test_roboticia_takes_the_angle_correction_of_express_for_signed():
    # 7.25 deg are 58 / 8; it reads the sixth bit as a sign and the rest as 26 / 8, one step late
    _, errors = judge("rplidar", A1, EXPRESS)
    step = 360 * A1.turns / A1.modes[EXPRESS].sample_rate
    assert np.median(errors) == pytest.approx(7.25 + 26 / 8 + step, abs=0.2)


def test_adafruit_reads_nodes():
    read, errors = judge("adafruit_rplidar", A1, STANDARD)
    assert read["health"] == ["Warning", SWAPPED]
    assert abs(np.median(errors)) < 0.15
    assert np.mean(np.abs(errors) < 0.4) > 0.99


def test_rplidarc1_reads_nodes_and_loses_a_bit_of_the_angle():
    _, errors = judge("rplidarc1", C1, STANDARD)
    assert np.abs(errors).max() < 1.5
    assert np.mean(np.abs(errors) > 0.4) > 0.3
    assert math.isfinite(np.median(errors))
