"""``--resume DIR``: continue a recorded run with the same robot, settings and session."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import check_planner
from scan3d_twin.core.session import Session
from scan3d_twin.recording.load import (
    RecordedRun,
    load_session,
    read_commands,
    read_journey,
    read_last_odometry,
)
from scan3d_twin.recording.resume import continue_odometry, moved_warning, reenact
from scan3d_twin.run.closed_loop import EarlierRun
from scan3d_twin.run.report import Journey
from scan3d_twin.run.settings import REAL_SCENE, Options, Settings, build_settings, settings_toml

Notify = Callable[[str], None]
"""Shows a message to the user."""


@dataclass(frozen=True)
class ResumedRun:
    """A recorded run that is continued.

    Attributes:
        recorded: The run up to its last finished view or plan.
        settings: The effective settings: given options over the recorded ones.
        journey: How it got there.
        place_robot: Takes a robot that was just opened to where the run was, and returns it.
    """

    recorded: RecordedRun
    settings: Settings
    journey: Journey
    place_robot: Callable[[Robot, Notify], Robot]

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return self.recorded.path.parent

    @property
    def earlier(self) -> EarlierRun:
        """The finished part of the run, for the loop."""
        return EarlierRun(self.recorded.session, self.journey)


def resume_sim(folder: Path, out: Path | None, given: Options) -> ResumedRun:
    """Return the run of the twin in ``folder``, to be continued with the ``given`` options.

    Raises:
        ConfigError: A given option would make it another run.
        FileError: There is no such run, or no view was finished in it.
    """
    recorded = _load(folder, out)
    if recorded.settings.run.scene == REAL_SCENE:
        raise ConfigError(f"{folder} was scanned by the real robot: twin real --resume {folder}")
    effective = _settings(recorded, given)
    check_planner(effective.config.planner, truth_known=True)
    sent = list(read_commands(recorded.path))

    def place_robot(robot: Robot, notify: Notify) -> Robot:
        notify(f"driving through the first {recorded.mark.stamp:.0f} s again")
        if not reenact(robot, sent, recorded.mark):
            notify("slightly off the recorded place: this computer rounds differently")
        return robot

    return ResumedRun(recorded, effective, read_journey(recorded), place_robot)


def resume_real(folder: Path, out: Path | None, given: Options) -> ResumedRun:
    """Return the run of the real robot in ``folder``; arguments and errors as ``resume_sim``."""
    recorded = _load(folder, out)
    if recorded.settings.run.scene != REAL_SCENE:
        raise ConfigError(f"{folder} was scanned by the twin: twin sim --resume {folder}")
    effective = _settings(recorded, given)
    check_planner(effective.config.planner, truth_known=False)
    stamp, T_odom_here = read_last_odometry(recorded.path)

    def place_robot(robot: Robot, notify: Notify) -> Robot:
        notify("resuming where the robot stopped; it must not have been moved since")
        return continue_odometry(robot, T_odom_here, stamp)

    return ResumedRun(recorded, effective, read_journey(recorded), place_robot)


def _load(folder: Path, out: Path | None) -> RecordedRun:
    if out is not None:
        raise ConfigError("--resume continues in the run's own folder; leave out --out")
    return load_session(folder)


def _settings(recorded: RecordedRun, given: Options) -> Settings:
    """Return the recorded settings, overridden by the ``given`` options."""
    before = recorded.settings
    effective = build_settings([tomllib.loads(settings_toml(before)), given])
    if (effective.run, effective.twin) != (before.run, before.twin):
        raise ConfigError(
            "--resume continues with the run's own scene, seed, preset, world, robot, lidar link "
            "and target; leave these out"
        )
    return effective


class MovedCheck(Unobserved):
    """Warns if the first view after resuming shows that the robot was moved."""

    def __init__(self, known: int, notify: Notify) -> None:
        self._known = known
        self._notify = notify

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        if len(session.views) == self._known + 1 and (words := moved_warning(session)):
            self._notify(words)
