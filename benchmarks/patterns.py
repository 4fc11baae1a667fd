"""One view of living_room by each pattern: ``python patterns.py [--seeds N]``.

Run in ``benchmarks/``. Prints the table of docs/patterns.md, means over the seeds, and draws the
clouds of the first seed side by side into ``docs/images/patterns.png``. The same program writes the
same bytes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import scan3d_twin as s3d
from scan3d_twin.core.config import PATTERNS
from scan3d_twin.core.png import Picture, encode_png
from scan3d_twin.core.scanning.sphere_density import SphereDensity, measure_density
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import FloatArray, RangeImage
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim

SCENE, FIRST_SEED = "living_room", 1000
PICTURE = Path(__file__).parent.parent / "docs" / "images" / "patterns.png"
WIDTH, HEIGHT = 460, 360
"""Size of a panel [pixels]."""
VIEW_YAW, VIEW_PITCH = np.radians(-60.0), np.radians(38.0)
"""From where the clouds are seen: behind the robot on its right, from above."""
SHIFT = (-40, 10)
"""Place of the robot right of and below the middle of a panel [pixels]."""
ROOM = 3.2
"""Half the width of what a panel shows [m]."""
CEILING = 2.2
"""Height from which on points are left out, so that one sees into the room [m]."""


def digitize(pattern: str, seed: int) -> tuple[s3d.Session, s3d.Evaluation, float]:
    """Return a session of one view, its evaluation, and the time on the robot's clock [s]."""
    twin = replace(TwinConfig.of("typical"), pattern=pattern)
    with open_sim(SCENE, seed, twin) as (robot, truth):
        session = s3d.digitize(robot, s3d.Config(max_views=1), seed=seed)
        return session, s3d.evaluate(session, truth), robot.clock.now()


def take_sweep(pattern: str, seed: int) -> RangeImage:
    """Return the raw sweep from where the robot starts."""
    twin = replace(TwinConfig.of("typical"), pattern=pattern)
    with open_sim(SCENE, seed, twin) as (robot, _):
        return sweep(robot, 0.0, s3d.Config(), lambda _: None).image


def draw(points: FloatArray) -> Picture:
    """Return a panel with ``points`` (n, 3), coloured by height, the nearer before the farther."""
    # Turn them to the eye
    points = points[points[:, 2] < CEILING]
    c, s = np.cos(-VIEW_YAW - np.pi / 2), np.sin(-VIEW_YAW - np.pi / 2)
    x, y = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
    across, up = x, np.sin(VIEW_PITCH) * y + np.cos(VIEW_PITCH) * points[:, 2]
    depth = np.cos(VIEW_PITCH) * y - np.sin(VIEW_PITCH) * points[:, 2]

    # Paint them from back to front
    scale = WIDTH / (2 * ROOM)
    column = np.rint(WIDTH / 2 + scale * across + SHIFT[0]).astype(int)
    row = np.rint(HEIGHT / 2 - scale * up + SHIFT[1]).astype(int)
    inside = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
    order = np.flatnonzero(inside)[np.argsort(-depth[inside], kind="stable")]
    share = np.clip(points[order, 2] / CEILING, 0.0, 1.0)[:, None]
    colours = (1 - share) * (32, 72, 160) + share * (216, 120, 32)
    panel = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    panel[row[order], column[order]] = np.rint(colours).astype(np.uint8)
    return panel


def describe(density: SphereDensity) -> str:
    """Return a density as two columns of the table."""
    spread = f"{density.low:.1f} / {density.median:.1f} / {density.high:.1f}"
    return f"{density.seen:.0%} | {spread}"


def print_row(pattern: str, raw: RangeImage, seeds: range) -> None:
    """Print the row of a pattern: means over the ``seeds``, the density of one ``raw`` sweep."""
    runs = [digitize(pattern, seed) for seed in seeds]
    points = np.mean([len(session.views[0].target) for session, _, _ in runs])
    coverage = np.mean([evaluation.coverage for _, evaluation, _ in runs])
    error = np.mean([1e3 * evaluation.accuracy.median for _, evaluation, _ in runs])
    time = np.mean([seconds for _, _, seconds in runs])
    print(
        f"| `{pattern}` | {describe(measure_density(raw))} | "
        f"{np.count_nonzero(np.isfinite(raw.ranges))} | {points:.0f} | {coverage:.0%} | "
        f"{error:.1f} mm | {time:.0f} s |",
        flush=True,
    )


def join(panels: list[Picture]) -> Picture:
    """Return four panels as one picture, two by two."""
    line = np.full((HEIGHT, 6, 3), 160, np.uint8)
    rows = [np.concatenate([a, line, b], axis=1) for a, b in (panels[:2], panels[2:])]
    across = np.full((6, rows[0].shape[1], 3), 160, np.uint8)
    return np.concatenate([rows[0], across, rows[1]])


def main() -> None:
    """Print the table and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="number from 1000 on; 0: no table")
    seeds = range(FIRST_SEED, FIRST_SEED + parser.parse_args().seeds)
    raw = {pattern: take_sweep(pattern, FIRST_SEED) for pattern in PATTERNS}
    if seeds:
        print(
            "| pattern | sphere seen | readings per deg2, low / median / high | readings |"
            " points | coverage | median error | time |\n|---|---|---|---|---|---|---|---|"
        )
        for pattern, image in raw.items():
            print_row(pattern, image, seeds)
    panels = [draw(image.points[np.isfinite(image.ranges)]) for image in raw.values()]
    PICTURE.write_bytes(encode_png(join(panels)))
    print(f"wrote {PICTURE}")


if __name__ == "__main__":
    main()
