"""Test helper: a short run of a robot without physics, recorded as the program records it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import synthetic
from kinematic import JumpingClock, KinematicBase

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.motion_control import drive_to
from scan3d_twin.core.types import VALID, ScanLine
from scan3d_twin.recording.recorder import Recorder
from scan3d_twin.run.settings import Settings

LINES = 12
"""Lines of each view."""


def make_robot():
    """Return a robot on a clock that only jumps."""
    base = KinematicBase()
    return Robot(base, SimpleNamespace(spec=synthetic.spec()), JumpingClock(base))


def line(stamp):
    """Return a line whose first reading is an error."""
    ranges, codes = np.linspace(0.5, 4.0, 682), np.full(682, VALID)
    ranges[0], codes[0] = np.nan, 19
    return ScanLine(stamp, ranges, codes)


def drive(recorder, robot, session):
    """Let ``recorder`` see a run that ends up with ``session``; yield after each of its steps."""
    seen = replace(session, views=(), plans=(), stop_reason="")
    for k, view in enumerate(session.views):
        recorder.on_event(f"driving to viewpoint {k}")
        drive_to(robot, 0.3 * (k + 1), 0.0, MotionConfig())
        for _ in range(LINES):
            robot.clock.sleep(0.1)
            recorder.on_line(line(robot.clock.now()))
        seen = seen.with_view(view)
        recorder.on_view(seen)
        yield seen
        seen = seen.with_plan(session.plans[k])
        recorder.on_plan(seen)
        yield seen


def record(folder, session, *, wall=lambda: 0.0, finish=True):
    """Record a run that ends up with ``session`` in ``folder`` and return the recorder."""
    recorder = Recorder(folder, wall, {"command": "twin sim", "scan3d_twin": "0"})
    recorder.describe("boxes", replace(Settings(), config=session.config))
    for _ in drive(recorder, recorder.attach(make_robot()), session):
        pass
    recorder.finish(session) if finish else recorder.close()
    return recorder
