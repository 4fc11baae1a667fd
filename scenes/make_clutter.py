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


def thing(number: int, rng: random.Random) -> tuple[float, float, float, str]:
    """Return a thing's place and radius [m], and its geom."""
    radius, height = rng.uniform(0.04, 0.16), rng.uniform(0.08, 0.9)
    x, y = rng.uniform(-HALF_X, HALF_X) * 0.94, rng.uniform(-HALF_Y, HALF_Y) * 0.94
    kind = rng.choice(("box", "box", "cylinder", "ellipsoid"))
    turn = rng.uniform(0, 90)
    sizes = {
        "box": f"{radius * 0.7:.3f} {radius * 0.7:.3f} {height / 2:.3f}",
        "cylinder": f"{radius:.3f} {height / 2:.3f}",
        "ellipsoid": f"{radius:.3f} {radius * 0.8:.3f} {height / 2:.3f}",
    }
    geom = (
        f'    <geom name="thing_{number:03}" type="{kind}" pos="{x:.3f} {y:.3f} {height / 2:.3f}" '
        f'size="{sizes[kind]}" euler="0 0 {turn:.0f}" material="{rng.choice(MATERIALS)}"/>\n'
    )
    return x, y, radius, geom


def main() -> None:
    """Write the scene."""
    rng = random.Random(100)
    placed: list[tuple[float, float, float, str]] = []
    while len(placed) < COUNT:
        x, y, radius, geom = thing(len(placed), rng)
        free = all(math.dist((x, y), (u, v)) > radius + r for u, v, r, _ in placed)
        if free and not blocked(x, y, radius):
            placed.append((x, y, radius, geom))
    geoms = "".join(geom for *_, geom in placed)
    text = HEAD + geoms + "  </worldbody>\n</mujoco>\n"
    (Path(__file__).parent / "clutter_100.xml").write_text(text)


if __name__ == "__main__":
    main()
