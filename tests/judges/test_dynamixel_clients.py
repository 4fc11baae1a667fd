"""The maker's packages turn the emulated XL330, over a pseudo-terminal, as their examples do."""

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from virtual import VirtualClock
from virtual_table import VirtualTable

from scan3d_twin.devices.dynamixel.emulated_firmware import ServoProfile
from scan3d_twin.devices.dynamixel.emulator import Xl330Emulator
from scan3d_twin.devices.dynamixel.model import COUNT, M288
from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import serve

NO_ANSWER, ECHO_ONLY = -3001, -3002
"""Results of the SDK where a servo does not answer: nothing came, or nothing that it can use."""


def judge(client, **profile):
    """Let a ``client`` turn an emulated servo; return what it read, and the turntable."""
    clock = VirtualClock()
    table = VirtualTable(clock, acceleration=40.0)
    servo = Xl330Emulator(table, ServoProfile(**profile))
    program = Path(__file__).with_name("drive_dynamixel.py")
    with closing(PtyPort(Line(servo))) as port:
        command = [sys.executable, program, client, port.path, str(servo.baud)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            serve([port], clock, lambda: process.poll() is not None or clock.now() > 60.0)
            process.kill()
            (line,) = (each for each in process.stdout if each.startswith("{"))
    return json.loads(line), table


@pytest.mark.parametrize("echo", [False, True])
def test_the_sdk_pings_turns_and_reads_as_in_its_examples(echo):
    read, table = judge("dynamixel_sdk", baud=1_000_000, echo=echo)
    assert read["model"] == M288
    assert read["errors"] == [7, 6, ECHO_ONLY if echo else NO_ANSWER]
    assert read["reached"] == pytest.approx([1500, 2600, 2048], abs=1)
    angles = [angle for _, angle, _ in table.orders]
    assert angles == pytest.approx([(goal - 2048) * COUNT for goal in (1500, 2600, 2048)])
    assert read["volts"] == 5.0
    if not echo:
        assert read["found"] == {"1": [M288, 52]}


def test_the_easy_sdk_turns_by_the_makers_own_control_table():
    read, _ = judge("dynamixel_easy_sdk")
    assert read["name"] == "xl330_m288.model"
    assert read["reached"] == pytest.approx([1500, 2600], abs=1)
