"""Make the pictures of docs/registration.md: ``python benchmarks/registration_pictures.py``.

Writes SVG files to ``docs/images``. The same program writes the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from registration_data import FloatArray, Noise, pair, wall
from registration_data import scan as take
from ring_data import SIGMA_XY, SIGMA_YAW, chain, make_ring

from scan3d_twin.core.mapping.loop_closure import align_grids
from scan3d_twin.core.registration import (
    PosePrior,
    ScanNoise,
    SurfelGrid,
    extract_surfels,
    register,
)
from scan3d_twin.core.registration.surfels.extraction import VARIANCE, N, X
from scan3d_twin.core.registration.surfels.free_space import measure_contradiction
from scan3d_twin.core.types import Pose2

FOLDER = Path(__file__).parent.parent / "docs" / "images"
BLUE, RED, GREY, GREEN = "#2060a0", "#c03020", "#909090", "#208040"
HALF_WINDOW = 4
"""Readings to either side of a window for principal components: as wide as the regression's."""


class Picture:
    """A picture in data units [m or as stated], y up."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float], width: int = 480) -> None:
        self._x, self._y, self._scale = x, y, width / (x[1] - x[0])
        self._size = (width, round((y[1] - y[0]) * self._scale))
        self._parts: list[str] = []

    def stretched(self, height: int) -> Picture:
        """Let y have a scale of its own, so that the picture is ``height`` high."""
        self._size = (self._size[0], height)
        return self

    def at(self, x: float, y: float) -> str:
        """Return the place of a point as in an SVG path."""
        across = (x - self._x[0]) * self._scale
        up = (y - self._y[0]) / (self._y[1] - self._y[0]) * self._size[1]
        return f"{across:.1f},{self._size[1] - up:.1f}"

    def line(self, points: Iterable[tuple[float, float]], colour: str, width: float = 1.5) -> None:
        """Draw a line through ``points``."""
        text = " ".join(self.at(float(x), float(y)) for x, y in points)
        self._parts.append(
            f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
        )

    def dots(self, points: FloatArray, colour: str, radius: float = 1.0) -> None:
        """Draw ``points`` (n, 2)."""
        size, path = 2 * radius, []
        for x, y in points[:, :2]:
            path.append(f"M{self.at(float(x), float(y))}h0")
        self._parts.append(
            f'<path d="{"".join(path)}" stroke="{colour}" stroke-width="{size}" '
            'stroke-linecap="round"/>'
        )

    def ellipse(self, middle: tuple[float, float], C: FloatArray, colour: str) -> None:
        """Draw two standard deviations of a covariance (2, 2)."""
        turn = np.linspace(0, math.tau, 60)
        ring = 2 * np.linalg.cholesky(C) @ np.stack([np.cos(turn), np.sin(turn)])
        self.line(zip(middle[0] + ring[0], middle[1] + ring[1], strict=True), colour)

    def text(self, x: float, y: float, words: str, colour: str = "black") -> None:
        """Write from (x, y) on."""
        left, top = self.at(x, y).split(",")
        self._parts.append(f'<text x="{left}" y="{top}" fill="{colour}">{words}</text>')

    def save(self, name: str) -> None:
        """Write the picture."""
        width, height = self._size
        body = "\n".join(self._parts)
        text = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'font-family="sans-serif" font-size="13">\n'
            f'<rect width="{width}" height="{height}" fill="white"/>\n{body}\n</svg>\n'
        )
        (FOLDER / name).write_text(text, encoding="utf-8")


def normals() -> None:
    """Errors of normals against the incidence: inverse ranges, and principal components."""
    ours, others = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        image = take(wall(), Pose2(), 65.0, Noise(0.010), rng)
        table = extract_surfels(image, noise=ScanNoise(0.010, 0.010)).at(np.s_[:, :])
        beam = image.spec.n_beams // 2
        for line in range(HALF_WINDOW, image.n_lines - HALF_WINDOW):
            yaw = image.yaws[line, beam]
            if table[line, beam, VARIANCE] > 0:
                n = table[line, beam, N]
                ours.append((abs(yaw), math.copysign(1, yaw) * math.atan2(n[1], -n[0])))
            window = image.points[
                line - HALF_WINDOW : line + HALF_WINDOW + 1, beam - 6 : beam + 7
            ].reshape(-1, 3)
            if np.all(np.isfinite(window)):
                n = np.linalg.eigh(np.cov(window.T))[1][:, 0]
                n = n * -np.sign(n[0])
                others.append((abs(yaw), math.copysign(1, yaw) * math.atan2(n[1], -n[0])))
    picture = Picture((0, 65), (-12, 12)).stretched(260)
    picture.line([(0, 0), (65, 0)], GREY, 1)
    for values, colour in ((others, RED), (ours, BLUE)):
        angles, errors = np.degrees(np.array(values)).T
        edges = np.arange(0, 66, 5)
        middles = [
            (a + 2.5, float(np.median(errors[(angles >= a) & (angles < a + 5)])))
            for a in edges[:-1]
            if np.count_nonzero((angles >= a) & (angles < a + 5)) > 10
        ]
        picture.line(middles, colour, 2.5)
        picture.dots(np.column_stack([angles, errors])[::3], colour, 0.6)
    picture.text(2, 10, "error of the normal, -12 to 12 deg, over the incidence, 0 to 65 deg")
    picture.text(2, 8.2, "plane regression of inverse ranges", BLUE)
    picture.text(2, 6.4, "principal components of the points", RED)
    picture.save("registration_normals.svg")


def surfels_in_plan(grid: SurfelGrid, T: Pose2) -> FloatArray:
    """Return a band of surfels at half height in the top view (n, 2)."""
    middle = grid.image.spec.n_beams // 2
    index = grid.index[:, middle - 8 : middle + 8 : 4]
    rows = grid.rows[index[index >= 0]]
    return T.apply(rows[:, X])[:, :2]


def overlay() -> None:
    """Two sweeps before and after registration."""
    data = pair("boxes", Noise(0.010), 4, 0.04, math.radians(4.0))
    target, source = extract_surfels(data.target), extract_surfels(data.source)
    prior = PosePrior.planar(data.init, 0.04, math.radians(4.0))
    result = register(target, source, prior=prior, starts=8)
    picture = Picture((-0.85, 0.95), (0.72, 1.5))
    for x, T in ((-0.42, data.init), (0.48, Pose2.from_matrix(result.T_target_source))):
        for grid, pose, colour in ((target, Pose2(), BLUE), (source, T, RED)):
            points = surfels_in_plan(grid, pose)
            shown = np.column_stack([x - 0.45 * points[:, 1], points[:, 0]])
            picture.dots(shown, colour, 0.8)
    picture.text(-0.75, 0.86, "by odometry")
    picture.text(0.10, 0.86, f"registered, predicted error {1e3 * result.predicted_rmse:.1f} mm")
    picture.text(-0.75, 0.77, "target", BLUE)
    picture.text(-0.55, 0.77, "source", RED)
    picture.save("registration_overlay.svg")


def plain_wall() -> None:
    """Errors of x and y on a wall: by odometry, and registered, with their covariances."""
    guesses, results = [], []
    for seed in range(60):
        data = pair("wall", Noise(0.010), seed)
        prior = PosePrior.planar(data.init, 0.02, math.radians(2.0))
        result = register(extract_surfels(data.target), extract_surfels(data.source), prior=prior)
        for found, T in (
            (guesses, data.init),
            (results, Pose2.from_matrix(result.T_target_source)),
        ):
            found.append((T.y - data.truth.y, T.x - data.truth.x))
    C = result.covariance[np.ix_([1, 0], [1, 0])]
    picture = Picture((-0.07, 0.07), (-0.06, 0.06))
    picture.dots(np.array(guesses), GREY, 1.5)
    picture.dots(np.array(results), BLUE, 2.0)
    picture.ellipse((0, 0), np.eye(2) * 0.02**2, GREY)
    picture.ellipse((0, 0), C, BLUE)
    picture.text(-0.066, 0.052, "x over y, 140 mm wide; ellipses: 2 sigma as reported")
    picture.text(-0.066, 0.046, "odometry", GREY)
    picture.text(-0.066, 0.040, "registered on a plain wall: y is left to odometry", BLUE)
    picture.save("registration_wall.svg")


def free_space() -> None:
    """Contradiction with free space over a slide along a periodic surface."""
    data = pair("sine", Noise(0.010), 0)
    target, source = extract_surfels(data.target), extract_surfels(data.source)
    slides = np.linspace(-0.20, 0.20, 161)
    scores = []
    for slide in slides:
        T = (Pose2(0.0, float(slide)) @ data.truth).matrix()
        scores.append(measure_contradiction(target, source, T, 4))
    picture = Picture((-0.20, 0.20), (0.0, max(scores) * 1.25)).stretched(240)
    for k in range(-2, 3):
        picture.line([(0.083 * k, 0), (0.083 * k, max(scores))], GREY, 0.7)
    picture.line(zip(slides, scores, strict=True), BLUE, 2)
    picture.text(
        -0.195, max(scores) * 1.15, "contradiction over a slide by up to 200 mm; grey: periods"
    )
    picture.save("registration_free_space.svg")


def closed_ring() -> None:
    """Views around a cabinet by odometry, and aligned, with links and pose covariances."""
    ring = make_ring("cabinet", 0.010, 1, 12)
    grids = [extract_surfels(image) for image in ring.images]
    odometry = [PosePrior.planar(move, SIGMA_XY, SIGMA_YAW) for move in ring.moves]
    edges, solution = align_grids(grids, odometry)
    picture = Picture((-1.9, 4.6), (-1.6, 1.9), 640)
    for x, poses in ((0.0, chain(ring.moves)), (2.9, list(solution.poses))):
        place = Pose2(x - 1.2, 0.0)
        for grid, pose in zip(grids, poses, strict=True):
            picture.dots(surfels_in_plan(grid, place @ pose)[::3], BLUE, 0.5)
        if x:
            for edge in edges:
                ends = [place @ poses[edge.target], place @ poses[edge.source]]
                picture.line([(end.x, end.y) for end in ends], GREY, 0.6)
        for k, pose in enumerate(poses):
            there = place @ pose
            picture.dots(np.array([[there.x, there.y]]), RED, 3)
            if x and k:
                turn = there.matrix()[:2, :2]
                C = solution.covariance[3 * k : 3 * k + 2, 3 * k : 3 * k + 2]
                picture.ellipse((there.x, there.y), 20**2 * turn @ C @ turn.T, GREEN)
    picture.text(-1.8, 1.7, f"by odometry: {1e3 * ring.error(chain(ring.moves)):.0f} mm")
    error = 1e3 * ring.error(list(solution.poses))
    picture.text(1.2, 1.7, f"aligned: {error:.1f} mm; {len(edges)} links, covariances 20 x")
    picture.save("registration_ring.svg")


def main() -> None:
    for draw in (normals, overlay, plain_wall, free_space, closed_ring):
        draw()


if __name__ == "__main__":
    main()
