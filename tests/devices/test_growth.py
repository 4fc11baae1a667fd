"""An emulation may run for days: its memory use does not grow with time."""

import gc
import tracemalloc

import pytest

from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Op
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.packets import Packet
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.sim.base import drive_base as sim_base
from scan3d_twin.sim.robot import open_robot
from scan3d_twin.wired import HazardFreeClock

pytestmark = pytest.mark.slow

HISTORY, SURPLUS = 400, 100
"""Odometry for 6 s instead of 5 minutes, so that the test need not wait for it to fill."""
WHILE = 20.0
"""On the robot's clock; three times as long is longer than the world remembers poses [s]."""
ROOM = 100_000
"""What is under way at a moment differs by less [bytes]: a few lines of 11 kB."""


def held(wires, clock, seconds):
    """Let clients listen for ``seconds`` and return what is held in memory then [bytes]."""
    until = clock.now() + seconds
    while clock.now() < until:
        clock.sleep(0.05)
        for wire in wires:
            wire.read(0.0)
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def test_an_emulated_robot_that_streams_and_turns_holds_no_more_later(monkeypatch):
    monkeypatch.setattr(sim_base, "MIN_HISTORY", HISTORY)
    monkeypatch.setattr(sim_base, "FORGET_BATCH", SURPLUS)
    with open_robot("three_boxes", 0) as robot:
        clock = HazardFreeClock(robot.clock)
        base, lidar = Wire(CreateEmulator(robot.base), clock), Wire(UrgEmulator(robot.lidar), clock)
        base.write(oi.command(Op.START) + oi.command(Op.SAFE) + oi.drive_direct(50, -50))
        base.write(oi.command(Op.STREAM, 1, Packet.BUMPS_DROPS))
        lidar.write(scip.Request("MD", "0044072501000").encode())
        tracemalloc.start()
        try:
            before = held((base, lidar), clock, WHILE)
            passed = [wire.line.passed for wire in (base, lidar)]
            after = held((base, lidar), clock, 2 * WHILE)
        finally:
            tracemalloc.stop()
        assert all(w.line.passed > 2 * p for w, p in zip((base, lidar), passed, strict=True))
    assert after - before < ROOM
