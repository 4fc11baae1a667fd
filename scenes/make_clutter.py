"""Write clutter_100.xml: a box to scan among a hundred things that stand about.

Run: python scenes/make_clutter.py
"""

from __future__ import annotations

import math
import random  # noqa: TID251 - a scene is made once, with a seed of its own
from pathlib import Path

COUNT = 100
HALF_X, HALF_Y = 3.8, 3.3  # of the room's inside [m]
CLEAR = 1.9  # round the target: the robot's way at a standoff of 1.0 m [m]
START = (-1.65, 0.0)
Point = tuple[float, float, float]

MATERIALS = ("card", "cloth", "plastic", "black", "steel", "white")

HEAD = """<mujoco model="clutter_100">
  <!-- A box to scan among a hundred things that stand about, made by make_clutter.py. -->
  <custom>
    <text name="scan3d.description" data="a box among a hundred things, all round"/>
    <text name="scan3d.tour" data="full"/>
    <numeric name="scan3d.standoff" data="1.0"/>
  </custom>
  <asset>
    <material name="wall" rgba="0.85 0.85 0.82 1"/>
    <material name="card" rgba="0.76 0.60 0.42 1"/>
    <material name="cloth" rgba="0.50 0.30 0.30 1"/>
    <material name="plastic" rgba="0.30 0.50 0.75 1" metallic="0" roughness="0.2"/>
    <material name="black" rgba="0.04 0.04 0.04 1"/>
    <material name="steel" rgba="0.75 0.75 0.78 1" metallic="1" roughness="0.3"/>
    <material name="white" rgba="0.92 0.92 0.90 1" metallic="0" roughness="0.4"/>
  </asset>
  <worldbody>
    <light pos="0 0 3" dir="0.3 0 -1"/>
    <geom name="floor" type="plane" size="8 8 0.1" rgba="0.55 0.55 0.55 1"/>
    <geom name="wall_front" type="box" pos="3.85 0 1.25" size="0.05 3.4 1.25" material="wall"/>
    <geom name="wall_back" type="box" pos="-3.85 0 1.25" size="0.05 3.4 1.25" material="wall"/>
    <geom name="wall_left" type="box" pos="0 3.35 1.25" size="3.8 0.05 1.25" material="wall"/>
    <geom name="wall_right" type="box" pos="0 -3.35 1.25" size="3.8 0.05 1.25" material="wall"/>
    <geom name="target_box" type="box" pos="0 0 0.25" size="0.20 0.30 0.25" material="card"/>
    <site name="spawn" pos="-1.65 0 0" group="4"/>
"""


def blocked(x: float, y: float, radius: float) -> bool:
    """Return whether a thing of ``radius`` [m] at ``x``, ``y`` stands in the robot's way."""
    near_start = math.dist((x, y), START) < 0.5 + radius
    return math.hypot(x, y) < CLEAR + radius or near_start


def geom(name: str, kind: str, place: Point, size: str, material: str, turn: float = 0.0) -> str:
    """Return one geom."""
    x, y, z = place
    euler = f' euler="0 0 {turn:.0f}"' if kind == "box" else ""
    return (
        f'    <geom name="{name}" type="{kind}" pos="{x:.3f} {y:.3f} {z:.3f}" size="{size}"'
        f'{euler} material="{material}"/>\n'
    )


def crate(name: str, x: float, y: float, radius: float, rng: random.Random) -> str:
    """Return a box with a lid that stands over."""
    half, height, turn = radius * 0.62, rng.uniform(0.1, 0.5), rng.uniform(0, 90)
    material, over = rng.choice(MATERIALS), radius * 0.7
    body, lid = (x, y, height / 2), (x, y, height + 0.015)
    size = f"{half:.3f} {half:.3f} {height / 2:.3f}"
    return geom(f"{name}_body", "box", body, size, material, turn) + geom(
        f"{name}_lid", "box", lid, f"{over:.3f} {over:.3f} 0.015", material, turn
    )


def stool(name: str, x: float, y: float, radius: float, rng: random.Random) -> str:
    """Return a seat on four legs."""
    height, material = rng.uniform(0.3, 0.7), rng.choice(MATERIALS)
    seat = geom(f"{name}_seat", "cylinder", (x, y, height), f"{radius:.3f} 0.015", material)
    legs = ""
    for k in range(4):
        angle = math.tau * (k + 0.5) / 4
        u, v = x + 0.8 * radius * math.cos(angle), y + 0.8 * radius * math.sin(angle)
        size = f"0.012 0.012 {height / 2:.3f}"
        legs += geom(f"{name}_leg_{k}", "box", (u, v, height / 2), size, material)
    return seat + legs


def books(name: str, x: float, y: float, radius: float, rng: random.Random) -> str:
    """Return a pile of books, each turned its own way."""
    pile, height = "", 0.0
    for k in range(rng.randint(3, 6)):
        half = rng.uniform(0.012, 0.03)
        size = f"{radius * 0.75:.3f} {radius * 0.55:.3f} {half:.3f}"
        place = (x, y, height + half)
        pile += geom(f"{name}_{k}", "box", place, size, rng.choice(MATERIALS), rng.uniform(0, 90))
        height += 2 * half
    return pile


def bottle(name: str, x: float, y: float, radius: float, rng: random.Random) -> str:
    """Return a bottle with a neck."""
    height, material = rng.uniform(0.15, 0.4), rng.choice(MATERIALS)
    body = f"{radius * 0.6:.3f} {height / 2:.3f}"
    neck = (x, y, height + 0.04)
    return geom(f"{name}_body", "cylinder", (x, y, height / 2), body, material) + geom(
        f"{name}_neck", "cylinder", neck, f"{radius * 0.2:.3f} 0.04", material
    )


def ball(name: str, x: float, y: float, radius: float, rng: random.Random) -> str:
    """Return a ball."""
    return geom(name, "sphere", (x, y, radius), f"{radius:.3f}", rng.choice(MATERIALS))


def main() -> None:
    """Write the scene."""
    rng = random.Random(100)
    placed: list[Point] = []
    text = HEAD
    while len(placed) < COUNT:
        radius = rng.uniform(0.06, 0.17)
        x, y = rng.uniform(-HALF_X, HALF_X) * 0.94, rng.uniform(-HALF_Y, HALF_Y) * 0.94
        make = rng.choice((crate, crate, stool, stool, books, bottle, ball))
        free = all(math.dist((x, y), (u, v)) > radius + r for u, v, r in placed)
        if free and not blocked(x, y, radius):
            text += make(f"thing_{len(placed):03}", x, y, radius, rng)
            placed.append((x, y, radius))
    text += "  </worldbody>\n</mujoco>\n"
    (Path(__file__).parent / "clutter_100.xml").write_text(text)


if __name__ == "__main__":
    main()
