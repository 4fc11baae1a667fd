from itertools import product

import numpy as np
import pytest
from kinematic import JumpingClock, KinematicBase
from paper import paper_config

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.motion_control import drive_to
from scan3d_twin.core.observer import Observers, Unobserved, with_clock_callbacks
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import ScanLine

LINE = ScanLine(0.0, np.zeros(1), np.zeros(1, np.int64))
SESSION = Session(paper_config(), 0, np.zeros((0, 2)), np.zeros(2))


class Noting(Unobserved):
    """Writes each call, under its name, into a book shared with others."""

    def __init__(self, name, book, wanted="go"):
        self._name, self._book, self._wanted = name, book, wanted

    def on_event(self, text):
        self._book.append((self._name, text))

    def on_line(self, line):
        self._book.append((self._name, line))

    def on_view(self, session):
        self._book.append((self._name, session))

    def on_plan(self, session):
        self._book.append((self._name, session))

    def command(self):
        return self._wanted


@pytest.mark.parametrize(
    ("method", "argument"),
    [("on_event", "a"), ("on_line", LINE), ("on_view", SESSION), ("on_plan", SESSION)],
)
def test_each_hears_everything_in_order(method, argument):
    book = []
    both = Observers(Noting("first", book), Noting("second", book))
    getattr(both, method)(argument)
    assert [name for name, _ in book] == ["first", "second"]
    assert all(what is argument for _, what in book)


@pytest.mark.parametrize("wants", list(product(["go", "pause", "stop"], repeat=2)), ids="-".join)
def test_a_stop_wins_over_a_pause_and_a_pause_over_go(wants):
    both = Observers(*[Noting("", [], wanted) for wanted in wants])
    rank = {"go": 0, "pause": 1, "stop": 2}
    assert rank[both.command()] == max(rank[each] for each in wants)


def test_nobody_lets_the_run_go_on():
    assert Observers().command() == Unobserved().command() == "go"


def test_attendants_see_the_whole_way():
    base = KinematicBase()
    seen = []
    robot = with_clock_callbacks(
        Robot(base, None, JumpingClock(base)), lambda: seen.append(base.odometry().T_odom_base.x)
    )
    drive_to(robot, 1.0, 0.0, MotionConfig())
    assert np.max(np.diff(seen)) <= MotionConfig().speed * 0.031
    assert seen[-1] > 0.98


def test_what_an_attendant_raises_stops_the_wheels():
    base = KinematicBase()

    def attend():
        if base.odometry().T_odom_base.x > 0.3:
            raise ScanError("enough")

    robot = with_clock_callbacks(Robot(base, None, JumpingClock(base)), attend)
    with pytest.raises(ScanError, match="enough"):
        drive_to(robot, 1.0, 0.0, MotionConfig())
    assert base.speed == (0.0, 0.0)
    assert 0.3 < base.odometry().T_odom_base.x < 0.31
