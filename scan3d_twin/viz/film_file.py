"""Writes frames as a film: MP4 by PyAV (H.264), GIF by Pillow."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.png import Picture
from scan3d_twin.run.folder import fresh_part

MAX_GIF_COLOURS = 128
"""Colours of a GIF: half the most there can be, as few show and the file is half as long."""
GIF_TICK = 10
"""Unit of the durations of a GIF [ms] (GIF89a, section 23)."""
MAX_GIF_RATE = 50
"""Most pictures a second of a GIF: browsers show those of one tick for ten."""
CONSTANT_RATE_FACTOR = "23"
"""Quality of the H.264 encoder, its default: 0 loses nothing, 51 is the worst."""


def film_kind(path: Path, fps: int) -> str:
    """Return ``mp4`` or ``gif``, what the name ``path`` ends with.

    Raises:
        ConfigError: It is another ending, what writes it is not installed, or it cannot show
            ``fps`` pictures a second.
    """
    kind = path.suffix.lower().removeprefix(".")
    needed = {"mp4": "av", "gif": "PIL"}.get(kind)
    if needed is None:
        raise ConfigError(f"a film ends in .mp4 or .gif, got {path.name}")
    if any(importlib.util.find_spec(name) is None for name in (needed, "PIL")):
        raise ConfigError("films need PyAV and Pillow: pip install av pillow")
    if kind == "gif" and fps > MAX_GIF_RATE:
        raise ConfigError(f"a GIF shows {MAX_GIF_RATE} pictures a second at most, got --fps {fps}")
    return kind


def write_film(path: Path, frames: Iterable[Picture], fps: int) -> None:
    """Write ``frames`` to ``path`` at ``fps`` pictures a second: the whole file or nothing.

    Raises:
        ConfigError: See ``film_kind``.
        FileError: It cannot be written.
    """
    write: dict[str, Callable[[Path, Iterable[Picture], int], None]] = {
        "mp4": _write_mp4,
        "gif": _write_gif,
    }
    kind = film_kind(path, fps)
    try:
        with fresh_part(path) as part:
            write[kind](part, frames, fps)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error


def _write_mp4(path: Path, frames: Iterable[Picture], fps: int) -> None:
    import av

    # Exact bits: no time of writing in the header.
    options = {"movflags": "+faststart", "fflags": "+bitexact"}
    with av.open(str(path), "w", format="mp4", options=options) as file:
        stream: Any = None
        for number, picture in enumerate(frames):
            if stream is None:
                # One thread: the same bytes wherever it is made.
                encoder = {"crf": CONSTANT_RATE_FACTOR, "threads": "1"}
                stream = file.add_stream("libx264", rate=fps, options=encoder)
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, fps)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, fps)
            file.mux(stream.encode(frame))
        if stream is not None:
            file.mux(stream.encode())


def _write_gif(path: Path, frames: Iterable[Picture], fps: int) -> None:
    """Write a GIF; its whole ticks are shared out, so that each picture begins at its time."""
    from PIL import Image

    pictures = [Image.fromarray(each).quantize(MAX_GIF_COLOURS) for each in frames]
    ticks = [round(1000 * k / (GIF_TICK * fps)) for k in range(len(pictures) + 1)]
    pictures[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=[GIF_TICK * (end - start) for start, end in pairwise(ticks)],
        loop=0,
    )
