"""The observer that writes the session file during the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Literal

from scan3d_twin.core.errors import FileError, TwinError
from scan3d_twin.core.hal import BaseSpec, DriveBase, Robot
from scan3d_twin.core.navigation.motion_control import measure_travel
from scan3d_twin.core.observer import Command, with_clock_callbacks
from scan3d_twin.core.scanning.patterns import turn_lidar
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Hazards, Odometry, Pose2, ScanLine
from scan3d_twin.recording.load import RecordedRun
from scan3d_twin.recording.mcap import cdr, ros_display, ros_records
from scan3d_twin.recording.mcap import ros_messages as ros
from scan3d_twin.recording.mcap.file import McapFile
from scan3d_twin.recording.mcap.rewrite import reopen
from scan3d_twin.recording.names import (
    ANGLES,
    CLOUDS,
    COMMANDS,
    DRIVEN_PATH,
    MODEL,
    ODOMETRY,
    PART,
    RECORDS,
    SCANS,
    SESSION_FILE,
    VIEWPOINTS,
)
from scan3d_twin.recording.session_log import Mark, SessionLog
from scan3d_twin.run.settings import Settings, settings_toml

FRAMES_PERIOD = 0.1
"""Time between two statements of where the frames are, at most [s]: a line of the lidar."""


class SerialTaps:
    """Passes the bytes on the robot's serial lines to a ``listener``, if there is one."""

    def __init__(self) -> None:
        self.listener: Callable[[str, float, Literal["<", ">"], bytes], None] | None = None

    def base(self, stamp: float, direction: Literal["<", ">"], data: bytes) -> None:
        """Pass on bytes from or to the base; a ``Tap``."""
        if self.listener:
            self.listener("/serial/base", stamp, direction, data)

    def lidar(self, stamp: float, direction: Literal["<", ">"], data: bytes) -> None:
        """Pass on bytes from or to the lidar; a ``Tap``."""
        if self.listener:
            self.listener("/serial/lidar", stamp, direction, data)


class _TappedBase:
    """A ``DriveBase`` that reports its velocity commands."""

    def __init__(self, base: DriveBase, on_command: Callable[[float, float], None]) -> None:
        self._base = base
        self._on_command = on_command

    @property
    def spec(self) -> BaseSpec:
        """See ``DriveBase.spec``."""
        return self._base.spec

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``; the base comes first, the record second."""
        sent = self._base.set_velocity(linear, angular)
        self._on_command(linear, angular)
        return sent

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``."""
        return self._base.odometry()

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        return self._base.odometry_since(stamp)

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self._base.hazards()


class Recorder:
    """Writes all measurements, decisions and events of a run to ``session.mcap.part``.

    A killed run loses at most the last half second, on the robot's clock or on the computer's,
    whichever is shorter. ``finish`` gives the file its final name.
    """

    def __init__(
        self,
        folder: Path,
        wall: Callable[[], float],
        provenance: Mapping[str, str],
        earlier: RecordedRun | None = None,
    ) -> None:
        """Begin the session file of the run in ``folder``.

        Args:
            folder: Holds no session file, or that of ``earlier``.
            wall: Returns the computer's time [s]; only differences count.
            provenance: Versions, command and date of the program.
            earlier: The run to continue; None for a new one.

        Raises:
            FileError: The file cannot be written.
        """
        self.path = folder / SESSION_FILE
        self.mark = Mark() if earlier is None else earlier.mark
        self._reopened = None if earlier is None else reopen(earlier.path, wall)
        self._file = self._reopened.file if self._reopened else McapFile(_part(self.path), wall)
        self._log = SessionLog(None if earlier is None else earlier.session)
        self._robot: Robot | None = None
        self._T_world_odom = Pose2() if earlier is None else _odom_in_world(earlier.session)
        self._last: Odometry | None = None
        self._framed, self._turned = 0.0, -1.0
        self._path = [] if earlier is None else _path_of_views(earlier.session)
        self._kept = self._has_lines = False
        self._failure: FileError | None = None
        self._file.metadata("provenance", provenance)

    def describe(self, name: str, settings: Settings) -> None:
        """Write the ``name`` of the scene and the effective ``settings``."""
        self._file.metadata("settings", {"name": name, "toml": settings_toml(settings)})

    def attach(self, robot: Robot) -> Robot:
        """Return ``robot`` wrapped so that its odometry and commands are recorded."""
        # Record mount and first odometry
        self._robot = robot
        if self._reopened:
            self._last = robot.base.odometry()
        if robot.turntable is None:
            self._file.write(
                "/tf_static", robot.clock.now(), ros.encode_mount(robot.T_base_lidar), latched=True
            )
        self._follow()

        # Wrap base and clock
        recorded = replace(robot, base=_TappedBase(robot.base, self._on_command))
        return with_clock_callbacks(recorded, self._follow)

    def on_bytes(self, topic: str, stamp: float, direction: Literal["<", ">"], data: bytes) -> None:
        """Record bytes on a serial line; the ``listener`` of ``SerialTaps``.

        Never raises, because the bytes may be the stop command: the next line or move raises.
        """
        if self._file.sink.closed or self._failure is not None:
            return
        try:
            self._file.write(topic, stamp, cdr.encode_serial_bytes(stamp, direction, data))
        except FileError as error:
            self._failure = error

    def on_event(self, text: str) -> None:
        """See ``Observer``."""
        self._file.write("/rosout", self._now(), ros_records.encode_log(self._now(), text))

    def on_line(self, line: ScanLine) -> None:
        """See ``Observer``; stamped when the line was complete, as several may come at once."""
        self._follow()
        spec = self._attached().lidar.spec
        complete = line.stamp + spec.line_period
        if line.elevations is not None or line.beam_times is not None:
            self._file.write(ANGLES, complete, ros_records.encode_angles(line, spec))
        self._file.write(SCANS, complete, cdr.encode_scan(line, spec))
        self._has_lines = True

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        index, view, now = len(session.views) - 1, session.views[-1], self._now()
        self._T_world_odom = _odom_in_world(session)
        self._follow()
        self._file.write(CLOUDS, now, ros_display.encode_cloud(now, index, view))
        write_display(self._file, now, session)
        self._file.write(DRIVEN_PATH, now, ros_display.encode_path(now, self._path), latched=True)
        if view.registration is not None:
            placed = ros_records.encode_registration(now, index, view.registration)
            self._file.write("/registration", now, placed)
        self._keep(session)

    def on_plan(self, session: Session) -> None:
        """See ``Observer``."""
        index, plan, now = len(session.plans) - 1, session.plans[-1], self._now()
        self._follow()
        self._file.write("/plan", now, ros_records.encode_plan(now, index, plan))
        if plan.viewpoint is not None:
            self._file.write("/viewpoint", now, ros.encode_viewpoint(now, plan.viewpoint))
        markers = ros_display.encode_viewpoints(now, session)
        self._file.write(VIEWPOINTS, now, markers, latched=True)
        self._keep(session)

    def command(self) -> Command:
        """See ``Observer``: the recorder never stops a run."""
        return "go"

    def finish(self, session: Session) -> None:
        """Write the final session and give the file its name.

        Raises:
            FileError: The disk is full or gone; earlier data is kept.
        """
        self._follow()
        now = self._now()
        write_display(self._file, now, session)
        self._file.write(DRIVEN_PATH, now, ros_display.encode_path(now, self._path), latched=True)
        self._keep(session)
        finish_file(self._file, self.path)

    def abandon(self, *, keep: bool = False) -> bool:
        """Close the file; keep it if it holds a view, or a scan line and ``keep`` is set.

        Else delete it: where nothing was scanned, the error says all there is to know. A resumed
        run without a new view restores the file that it continued.

        Returns:
            Whether something is kept.
        """
        self.close()
        if self._kept:
            return True
        if self._reopened is not None:
            self._reopened.restore_old()
        elif not (keep and self._has_lines):
            self._file.sink.path.unlink(missing_ok=True)
            return False
        return True

    def close(self) -> None:
        """Close the file unfinished, to be recovered later; closing twice does nothing."""
        if self._file.sink.closed:
            return
        with suppress(TwinError):
            self._file.flush(self._now())
        self._file.sink.close()

    def _keep(self, session: Session) -> None:
        """Write the changes in ``session`` and a mark, and sync them to the disk."""
        now = self._now()
        here = self._attached().base.odometry().T_odom_base
        self.mark = replace(self.mark, stamp=now, T_odom_base=here)
        for kind, index, packed in self._log.changes(session, self.mark):
            record = cdr.encode_record(now, kind, index, packed)
            del packed  # megabytes, which the record holds now
            self._file.write(RECORDS, now, record)
        self._file.flush(now)
        self._file.sink.sync()
        self._kept = True

    def _follow(self) -> None:
        """Write the odometry since the last call."""
        # Report an earlier failure
        if self._failure is not None:
            raise self._failure

        # Add up path and turns
        robot = self._attached()
        since = 0.0 if self._last is None else self._last.stamp
        samples = robot.base.odometry_since(since)
        if self._last is not None:
            path, turn = measure_travel(samples)
            self.mark = replace(self.mark, path=self.mark.path + path, turn=self.mark.turn + turn)

        # Write the new samples
        fresh = [s for s in samples if self._last is None or s.stamp > self._last.stamp]
        for sample in fresh:
            self._file.write(ODOMETRY, sample.stamp, cdr.encode_odometry(sample, self._last))
            if sample is fresh[-1] or sample.stamp >= self._framed + FRAMES_PERIOD:
                frames = cdr.encode_frames(sample.stamp, self._T_world_odom, sample.T_odom_base)
                self._file.write("/tf", sample.stamp, frames)
                self._framed = sample.stamp
            self._extend_path(sample)
            self._last = sample
        self._follow_turntable(robot)

    def _follow_turntable(self, robot: Robot) -> None:
        """Write where the turntable held the lidar since the last call."""
        if robot.turntable is None or robot.T_base_axis is None:
            return
        for sample in robot.turntable.angles_since(self._turned):
            if sample.stamp > self._turned:
                T = turn_lidar(robot.T_base_axis, robot.T_base_lidar, sample.angle)
                self._file.write("/tf", sample.stamp, ros.encode_mount(T, sample.stamp))
                self._turned = sample.stamp

    def _extend_path(self, sample: Odometry) -> None:
        """Add where the robot is, as it is known now, if it has moved on."""
        pose = self._T_world_odom @ sample.T_odom_base
        if not self._path or pose.distance(self._path[-1][1]) >= ros_display.PATH_STEP:
            self._path.append((sample.stamp, pose))

    def _on_command(self, linear: float, angular: float) -> None:
        now = self._now()
        self._file.write(COMMANDS, now, cdr.encode_command(now, linear, angular))

    def _now(self) -> float:
        return 0.0 if self._robot is None else self._robot.clock.now()

    def _attached(self) -> Robot:
        if self._robot is None:
            raise FileError("nothing to record: attach a robot first")
        return self._robot


def write_display(file: McapFile, stamp: float, session: Session) -> None:
    """Write the model and the viewpoints of ``session`` for viewers, at ``stamp`` [s]."""
    file.write(MODEL, stamp, ros_display.encode_model(stamp, session), latched=True)
    file.write(VIEWPOINTS, stamp, ros_display.encode_viewpoints(stamp, session), latched=True)


def finish_file(file: McapFile, path: Path) -> None:
    """Complete ``file`` and rename it to ``path``, replacing a file of that name.

    Raises:
        FileError: The disk is full or gone.
    """
    file.finish()
    file.sink.rename(path)


def _part(path: Path) -> Path:
    return path.with_name(path.name + PART)


def _path_of_views(session: Session) -> list[tuple[float, Pose2]]:
    """Return the path of a run that is continued: the places of its views."""
    return [(float(each.image.stamps.max()), each.T_world_scan) for each in session.views]


def _odom_in_world(session: Session) -> Pose2:
    view = session.views[-1]
    return view.T_world_scan @ view.observation.T_odom_scan.inverse()
