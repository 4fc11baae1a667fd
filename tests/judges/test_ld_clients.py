"""A decoder that others wrote reads the emulated LDROBOT lidars."""

import importlib.util
import json
import select
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from round_scene import BLIND, RoundScene, true_range
from virtual import VirtualClock

from scan3d_twin.devices.ldrobot import model as ld
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import serve


@pytest.mark.parametrize("model", [ld.LD06, ld.LD19])
def test_lds2d_reads_the_scene(model):
    if importlib.util.find_spec("lds2d") is None:
        pytest.skip("lds2d is not installed: uv sync --group judges")
    clock = VirtualClock()
    scene = RoundScene(clock, model.spec, model.sample_rate)
    program = Path(__file__).with_name("read_lds2d.py")
    with closing(PtyPort(Line(LdEmulator(scene, model)))) as port:
        command = [sys.executable, str(program), model.name, port.path]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            until = time.monotonic() + 30.0

            def ended():
                assert time.monotonic() < until
                return select.select([process.stdout], [], [], 0.0)[0]

            serve([port], clock, ended)
            frequency, scans = json.loads(process.stdout.read())
    assert frequency == pytest.approx(10.0, abs=0.01)
    for scan in scans:
        degrees, millimetres, quality = np.array(scan).T
        assert abs(len(scan) - 450) <= 12
        assert np.all(np.diff(degrees) > 0)
        elevations = np.radians((degrees + 180) % 360 - 180)
        off = np.abs(elevations + np.pi / 2)
        assert np.all(millimetres[off < BLIND - 0.001] == 0)
        seen = off > BLIND + 0.001
        assert np.all(np.abs(millimetres - 1000 * true_range(elevations))[seen] <= 1.0)
        assert np.all((quality > 0) == (millimetres > 0))
