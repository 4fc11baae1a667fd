"""``--resume DIR``: what a run goes on with."""

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
from scan3d_twin.recording.load import RecordedRun, load_session, read_commands, read_last_odometry
from scan3d_twin.recording.resume import continue_odometry, moved_warning, reenact
from scan3d_twin.run.closed_loop import EarlierRun
from scan3d_twin.run.report import Journey
from scan3d_twin.run.settings import REAL_SCENE, Options, Settings, build_settings, settings_toml

Notify = Callable[[str], None]


@dataclass(frozen=True)
class ResumedRun:
    """A recorded run that goes on.

    Attributes:
        recorded: As far as it got.
        settings: The effective ones, those stated now over the recorded ones.
        place: Returns a robot that was just opened as it is to be used; tells what is worth it.
    """

    recorded: RecordedRun
    settings: Settings
    place: Callable[[Robot, Notify], Robot]

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return self.recorded.path.parent

    @property
    def earlier(self) -> EarlierRun:
        """What the loop goes on from."""
        mark = self.recorded.mark
        return EarlierRun(self.recorded.session, Journey(mark.path, mark.turn, mark.stamp))


def resume_sim(folder: Path, out: Path | None, given: Options) -> ResumedRun:
    """Return how the run of the twin in ``folder`` goes on, with what else is ``given``.

    Raises:
        ConfigError: Something is given that would make it another run.
        FileError: There is no such run, or nothing was finished in it.
    """
    recorded = _load(folder, out)
    if recorded.settings.run.scene == REAL_SCENE:
        raise ConfigError(f"{folder} was scanned by the real robot: twin real --resume {folder}")
    effective = _settings(recorded, given)
    check_planner(effective.config.planner, truth_known=True)
    sent = list(read_commands(recorded.path))

    def place(robot: Robot, tell: Notify) -> Robot:
        tell(f"driving through the first {recorded.mark.stamp:.0f} s again")
        if not reenact(robot, sent, recorded.mark):
            tell("not quite where it was: this computer rounds otherwise than the one before")
        return robot

    return ResumedRun(recorded, effective, place)


def resume_real(folder: Path, out: Path | None, given: Options) -> ResumedRun:
    """Return how the run of the real robot in ``folder`` goes on; errors as ``resume_sim``."""
    recorded = _load(folder, out)
    if recorded.settings.run.scene != REAL_SCENE:
        raise ConfigError(f"{folder} was scanned by the twin: twin sim --resume {folder}")
    effective = _settings(recorded, given)
    check_planner(effective.config.planner, truth_known=False)
    stamp, T_odom_here = read_last_odometry(recorded.path)

    def place(robot: Robot, tell: Notify) -> Robot:
        tell("going on from where the robot was; it must not have been moved since")
        return continue_odometry(robot, T_odom_here, stamp)

    return ResumedRun(recorded, effective, place)


def _load(folder: Path, out: Path | None) -> RecordedRun:
    if out is not None:
        raise ConfigError("--resume goes on in its own folder; leave out --out")
    return load_session(folder)


def _settings(recorded: RecordedRun, given: Options) -> Settings:
    """Return the recorded settings under what is ``given``."""
    before = recorded.settings
    effective = build_settings([tomllib.loads(settings_toml(before)), given])
    if (effective.run, effective.twin) != (before.run, before.twin):
        raise ConfigError(
            "--resume goes on with the run's own scene, seed, preset, world, robot, lidar link and "
            "target; leave these out"
        )
    return effective


class MovedCheck(Unobserved):
    """Says so if the first view that is taken after going on does not lie where it should."""

    def __init__(self, known: int, tell: Notify) -> None:
        self._known = known
        self._tell = tell

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        if len(session.views) == self._known + 1 and (words := moved_warning(session)):
            self._tell(words)
