"""Write meshes/sine_box.obj: the paper's 40 x 30 x 50 cm model with one wavy side and a notch.

Run: python scenes/make_sine_box.py
"""

from __future__ import annotations

import math
from pathlib import Path

WIDTH, DEPTH, HEIGHT = 0.40, 0.30, 0.50  # along y, x, z [m]; issue's figures, paper Fig. 10
AMPLITUDE, PERIOD = 0.02, 0.08  # of the sine [m]
NOTCH = 0.03  # width and depth [m]
# About 2.5 mm wide, so that the chord lies within .1 mm of the sine. No edge lies at y = 0 or at
# the lidar's height of .30 m: a ray exactly along an edge may slip through between triangles.
COLUMNS_BESIDE, COLUMNS_NOTCH = 74, 11
COLUMNS = 2 * COLUMNS_BESIDE + COLUMNS_NOTCH
ROWS = 11  # not one row: MuJoCo casts rays slowly against long slivers

Point = tuple[float, float, float]


def columns() -> list[float]:
    """Return the edges of the columns along y [m], rising; the notch falls on edges."""
    side, notch = (WIDTH - NOTCH) / 2, NOTCH / 2
    left = [-WIDTH / 2 + side * k / COLUMNS_BESIDE for k in range(COLUMNS_BESIDE)]
    middle = [-notch + NOTCH * k / COLUMNS_NOTCH for k in range(COLUMNS_NOTCH + 1)]
    return left + middle + [-y for y in reversed(left)]


def outline() -> list[tuple[float, float]]:
    """Return the corners (x, y) of the footprint [m], counter-clockwise from above."""
    ys = columns()
    wave = [(-DEPTH / 2 + AMPLITUDE * math.sin(math.tau * y / PERIOD), y) for y in ys]
    back = []
    for y in ys:
        inside = abs(y) < NOTCH / 2 - 1e-9
        at_edge = abs(abs(y) - NOTCH / 2) < 1e-9
        pair = [(DEPTH / 2, y), (DEPTH / 2 - NOTCH, y)]
        back += (pair if y < 0 else pair[::-1]) if at_edge else [pair[inside]]
    return wave[::-1] + back


def build() -> tuple[list[Point], list[tuple[int, int, int]]]:
    """Return vertices and outward facing triangles."""
    ring = outline()
    n = len(ring)
    points = [(x, y, HEIGHT * row / ROWS) for row in range(ROWS + 1) for x, y in ring]
    faces = []
    for row in range(ROWS):
        for k in range(n):
            a, b = row * n + k, row * n + (k + 1) % n
            faces += [(a, b, b + n), (a, b + n, a + n)]
    for front, back in _cap_strips(ring):
        (a, b), (c, d) = front, back  # a, b fall in y along the wave; c, d rise along the back
        top = ROWS * n
        faces += [(a + top, b + top, c + top), (a + top, c + top, d + top)]
        faces += [(a, c, b), (a, d, c)]
    return points, faces


def _cap_strips(
    ring: list[tuple[float, float]],
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return per column its edge on the wave and its edge on the back, as indices in ``ring``."""
    wave = [(k, k + 1) for k in range(COLUMNS)]
    start = COLUMNS + 1
    back = [
        (k, k + 1)
        for k in range(start, len(ring) - 1)
        if ring[k][1] != ring[k + 1][1]  # not the sides of the notch
    ]
    return list(zip(wave[::-1], back, strict=True))


def main() -> None:
    """Write the mesh as Wavefront OBJ, in metres."""
    points, faces = build()
    lines = [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in points]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path = Path(__file__).parent / "meshes" / "sine_box.obj"
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
