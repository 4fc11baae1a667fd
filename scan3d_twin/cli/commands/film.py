"""``twin film``: a run as a film."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.cli.output import say

if TYPE_CHECKING:
    from scan3d_twin.core.png import Picture

TELL_EVERY = 15
"""Number of frames after which the progress is told."""


def film(
    run: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(show_default="film.mp4 in the run's folder")] = None,
    seconds: float = 10.0,
    fps: int = 15,
) -> None:
    """Make a film of a run: the robot drives, the cloud grows, the errors appear.

    Made from the recording, on no screen; a real run is shown without its surroundings. Needs the
    packages av and pillow (extra `film`).

    Args:
        run: The run's folder, or its session file.
        out: The file to write, .mp4 or .gif.
        seconds: Length of the film [s].
        fps: Pictures a second.
    """
    from scan3d_twin.cli.progress import make_progress, steps
    from scan3d_twin.core.errors import ConfigError
    from scan3d_twin.recording.load import load_session, run_folder
    from scan3d_twin.viz.film_file import film_kind, write_film

    if not 1 <= seconds <= 600:
        raise ConfigError(f"--seconds must be 1 to 600, got {seconds:g}")
    if not 1 <= fps <= 60:
        raise ConfigError(f"--fps must be 1 to 60, got {fps}")
    path = run_folder(run) / "film.mp4" if out is None else out
    film_kind(path, fps)
    from scan3d_twin.viz.film import draw_frames, prepare_film

    with make_progress() as progress:
        progress.on_event("reading the run")
        prepared = prepare_film(load_session(run))
        count = max(2, round(seconds * fps))
        step = steps(progress, "frame", count)
        frames = draw_frames(prepared, count)
        write_film(path, _telling(frames, step), fps)
    say(str(path), sys.stdout)


def _telling(frames: Iterable[Picture], step: Callable[[int], None]) -> Iterator[Picture]:
    """Yield ``frames`` and tell the progress now and then."""
    for k, frame in enumerate(frames):
        yield frame
        if k % TELL_EVERY == TELL_EVERY - 1:
            step(k)
