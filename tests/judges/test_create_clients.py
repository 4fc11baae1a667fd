"""Drivers that others wrote drive the emulated base and read its sensors."""

import importlib.util
import json
import math
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from emulated_base import Road
from kinematic import turned

from scan3d_twin.devices.create.codec import CREATE2
from scan3d_twin.devices.create.roomba import ROOMBA500

METRES_PER_COUNT = math.pi * 0.072 / 508.8
DRIVEN = 0.05
"""Way that shows that the base drove [m]: .2 m, less what a busy computer serves too late."""


def judge(name, model=CREATE2):
    """Let the client ``name`` drive a ``model``; return what it read, and where the base is."""
    if importlib.util.find_spec(name) is None:
        pytest.skip(f"{name} is not installed: uv sync --group judges")
    program = Path(__file__).with_name(f"drive_{name}.py")
    with closing(Road(model)) as road:
        command = [sys.executable, str(program), road.port.path]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            road.serve(lambda: process.poll() is not None, timeout=30.0)
            # The clients print lines of their own.
            (line,) = (each for each in process.stdout if each.startswith("["))
            return json.loads(line), road.base


@pytest.mark.parametrize("model", [CREATE2, ROOMBA500], ids=lambda model: model.name)
def test_pycreate2_drives_and_reads(model):
    (before, middle, after), base = judge("pycreate2", model)
    assert [each["open_interface_mode"] for each in (before, middle, after)] == [2, 2, 2]
    assert before["voltage"] == 16000
    way = (middle["encoder_counts_left"] - before["encoder_counts_left"]) * METRES_PER_COUNT
    truth = base.odometry().T_odom_base
    assert way == pytest.approx(math.hypot(truth.x, truth.y), abs=0.002)
    assert middle["distance"] == pytest.approx(1000 * way, abs=2)
    right = after["encoder_counts_right"] - middle["encoder_counts_right"]
    left = after["encoder_counts_left"] - middle["encoder_counts_left"]
    turn = (right - left) * METRES_PER_COUNT / 0.235
    assert turn == pytest.approx(turned(base), abs=0.02)
    assert after["angle"] == pytest.approx(math.degrees(turn), abs=1.5)


def test_pyroombaadapter_drives_and_reads():
    (before, after, mode, voltage), base = judge("pyroombaadapter")
    truth = base.odometry().T_odom_base
    way = [(b - a) * METRES_PER_COUNT for a, b in zip(before, after, strict=True)]
    assert way == pytest.approx([truth.x, truth.x], abs=0.002)
    assert truth.x > DRIVEN
    assert mode in (2, "Safe", "Safe Mode")
    assert voltage in (16.0, 16000)


def test_create_serial_drives_and_reads():
    """It writes each command byte by byte, and integrates the encoder counts itself."""
    rows, base = judge("create_serial")
    truth = base.odometry().T_odom_base
    (_, middle, after) = (row[:3] for row in rows)
    assert truth.x > DRIVEN
    assert middle == pytest.approx([1000 * truth.x, 0.0, 0.0], abs=2)
    assert after[:2] == pytest.approx([1000 * truth.x, 1000 * truth.y], abs=2)
    assert after[2] == pytest.approx(turned(base), abs=0.02)
    assert [row[3:] for row in rows] == [[2, 16000]] * 3
