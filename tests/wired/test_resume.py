"""A run of the real drivers that goes on after they were closed: the robot stands where it was."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_sweep

from scan3d_twin.core.observer import Observers, Unobserved
from scan3d_twin.core.types import rms
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.real.robot import open_over
from scan3d_twin.recording.load import load_session, read_last_odometry
from scan3d_twin.recording.recorder import Recorder
from scan3d_twin.recording.resume import continue_odometry, moved_warning
from scan3d_twin.run.closed_loop import EarlierRun, close_loop
from scan3d_twin.run.report import Journey
from scan3d_twin.run.settings import Settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import HazardFreeClock

SWEEP = paper_sweep(width=0.9, yaw_rate=0.3, look_rate=1.0)
SETTINGS = Settings(config=replace(paper_config(max_views=2), sweep=SWEEP))


class Warned(Unobserved):
    """Keeps what is to be said of the first view after going on."""

    said = None

    def on_view(self, session):
        if self.said is None:
            self.said = moved_warning(session)


def settings(views):
    planning = replace(SETTINGS.config.planning, epsilon=0.1)
    return replace(SETTINGS, config=replace(SETTINGS.config, max_views=views, planning=planning))


@pytest.fixture(scope="module")
def gone_on(tmp_path_factory):
    """A session of three views, the last by reopened drivers, and what was said of that one."""
    folder, timer = tmp_path_factory.mktemp("run"), itertools.count().__next__
    with open_sim("three_boxes", 0) as (twin, _):
        clock = HazardFreeClock(twin.clock)
        base = CreateEmulator(twin.base, oi.MODELS[twin.base.spec.name])
        lidar = UrgEmulator(twin.lidar, UrgProfile(usb=True))
        opening = lambda: open_over(  # noqa: E731
            Wire(base, clock), lambda: Wire(lidar, clock), clock
        )
        with opening() as robot:
            recorder = Recorder(folder, lambda: 0.0, {})
            recorder.describe("real", settings(2))
            close_loop(recorder.attach(robot), None, settings(2), recorder, timer)
            recorder.close()
        earlier = load_session(folder)
        stamp, here = read_last_odometry(earlier.path)
        again, warned = Recorder(folder, lambda: 0.0, {}, earlier), Warned()
        with opening() as robot:
            robot = again.attach(continue_odometry(robot, here, stamp))
            journey = Journey(earlier.mark.path, earlier.mark.turn, earlier.mark.stamp)
            both = Observers(again, warned)
            part = EarlierRun(earlier.session, journey)
            loop = close_loop(robot, None, settings(3), both, timer, part)
            again.finish(loop.session)
    return load_session(folder), loop, warned.said


def test_it_goes_on_to_the_next_view(gone_on):
    recorded, loop, said = gone_on
    assert loop.ended is None
    assert len(recorded.session.views) == 3
    assert said == ""
    assert recorded.mark.path == pytest.approx(loop.journey.path, abs=0.01)


def test_odometry_goes_on_within_its_error(gone_on):
    """The same check fails by decimetres if the drivers' new origin is not carried on."""
    recorded, *_ = gone_on
    a, b = recorded.session.views[1:]
    by_odometry = a.observation.T_odom_scan.inverse() @ b.observation.T_odom_scan
    registered = a.T_world_scan.inverse() @ b.T_world_scan
    points = b.target.points
    assert rms(by_odometry.apply(points) - registered.apply(points)) < 0.10


def test_stamps_go_on(gone_on):
    recorded, *_ = gone_on
    stamps = [view.observation.image.stamps for view in recorded.session.views]
    assert stamps[1].max() < stamps[2].min()
    assert np.all(np.diff(np.sort(stamps[2])) > 0)
