"""Sweeps of another scanner as a run: registered, with report, session and pictures."""

from __future__ import annotations

import math
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from scan3d_twin.api.run import RunOutcome
from scan3d_twin.api.save import save_run
from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import RegistrationError, ScanError
from scan3d_twin.core.placed_views import begin_placed_session, integrate_placed
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2, RangeImage
from scan3d_twin.recording.importing.source import ImportOptions, read_sweeps
from scan3d_twin.recording.written_session import follow_in_time, write_session
from scan3d_twin.run.folder import write_file
from scan3d_twin.run.report import Effort, Journey
from scan3d_twin.run.run_warnings import describe_doubts
from scan3d_twin.run.settings import REAL_SCENE, RunConfig, Settings, settings_toml
from scan3d_twin.run.versions import collect_versions
from scan3d_twin.sim.config import TwinConfig

YAW_SCALE_SIGMA = 0.001
"""Standard deviation of the relative error of the angles of a turning axis with a sensor or steps
of its own: a tooth of a gear in a thousand (an assumption)."""
LONGEST_RANGE = 100.0
"""Longest range that the configuration allows [m]."""
MIN_SWEEP, MAX_SWEEP = math.radians(1.0), math.tau
"""Limits of the configured angle of a sweep [rad]."""

Notify = Callable[[str], None]
"""Shows a message to the user."""


def import_scans(
    place: Path,
    folder: Path,
    options: ImportOptions,
    given: Config,
    notify: Notify,
    seed: int = 0,
) -> RunOutcome:
    """Register the sweeps of another scanner and save them as a run in ``folder``.

    A sweep that fits nowhere is left out, and named in the report. Nothing is written before all
    sweeps are registered.

    Args:
        place: File or folder of the sweeps.
        folder: Claimed for the results.
        options: How the readings are to be understood.
        given: The configuration; ranges and angles of the sweeps are set by the sweeps themselves.
        notify: Is told what was assumed, what is left out, and which views are unsure.
        seed: The run's one seed.

    Raises:
        FileError: The sweeps cannot be read, or the folder cannot be written.
        SceneError: There is no salient target, and only that is wanted.
        ScanError: No second sweep fits.
    """
    # Read the sweeps
    started = time.perf_counter()
    images = read_sweeps(place, options, notify)
    notify(f"{place}: {len(images)} sweep" + ("" if len(images) == 1 else "s"))

    # Register one after the other
    config = _fit_config(given, images)
    session, notes = register_images(images, config, seed, notify)
    if len(images) > 1 and len(session.views) == 1:
        raise ScanError(
            f"none of the {len(images)} sweeps fits the first; are they of one room, and taken "
            "within about 1 m and 60 deg of each other?"
        )
    session = session.with_stop_reason(_describe_end(session))
    for words in describe_doubts(session):
        notify(f"warning: {words}")

    # Save session, report and pictures
    twin = TwinConfig(robot="stand", pattern="yaw")
    settings = Settings(RunConfig(scene=REAL_SCENE, seed=seed), config, twin)
    name = place.resolve().stem or "import"
    command = {"command": shlex.join(sys.argv), "started": _now()}
    mark = write_session(
        folder, name, settings, session, {**collect_versions(), **command}, time.monotonic
    )
    write_file(folder / "config.toml", settings_toml(settings))
    effort = Effort(time.perf_counter() - started, 0.0, 0.0)
    journey = Journey(0.0, 0.0, mark.stamp)
    report = save_run(folder, name, settings, session, journey, effort, notes=notes)
    return RunOutcome(folder, report, session, None)


def register_images(
    images: Sequence[RangeImage], config: Config, seed: int, notify: Notify
) -> tuple[Session, list[str]]:
    """Return the session of ``images``, and a sentence for each one that fits nowhere."""
    observations = follow_in_time(
        [Observation(image, Pose2(), has_odometry=False) for image in images]
    )
    session, notes = begin_placed_session(observations[0], config, seed), []
    for k, observation in enumerate(observations[1:], 1):
        notify(f"registering sweep {k}")
        try:
            session = integrate_placed(session, observation)
        except RegistrationError as error:
            reason = str(error).partition(": ")[2] or str(error)
            notes.append(f"Sweep {k} is left out: {reason}.")
            notify(f"warning: {notes[-1]}")
    return session, notes


def _fit_config(given: Config, images: Sequence[RangeImage]) -> Config:
    """Return the ``given`` configuration with the ranges and angles of the sweeps."""
    reach = max(image.spec.max_range for image in images)
    widths = [float(image.yaws.max() - image.yaws.min()) for image in images]
    width = min(max(MIN_SWEEP, max(widths)), MAX_SWEEP)
    return replace(
        given,
        max_views=max(1, min(len(images), 1000)),
        target=replace(given.target, max_range=min(reach, LONGEST_RANGE)),
        sweep=replace(given.sweep, width=width, margin=0.0),
        # Whose lidar it was, and how noisy, nobody says.
        registration=replace(
            given.registration, yaw_scale_sigma=YAW_SCALE_SIGMA, reading_sigma=0.0
        ),
    )


def _describe_end(session: Session) -> str:
    count = len(session.views)
    return f"{count} view{'' if count == 1 else 's'} imported"


def _now() -> str:
    return f"{datetime.now().astimezone():%Y-%m-%dT%H:%M:%S%z}"
