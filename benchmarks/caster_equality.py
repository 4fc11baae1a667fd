"""Random rays by both ray casters: the share in which they differ, by scene.

    python benchmarks/caster_equality.py SCENE... [--rays 1000000]

A ray differs where one caster hits and the other misses, where the geoms differ, or where the
distances are more than ``TOLERANCE`` apart. Origins are spread over the scene below 1 m and 5 m
round it, directions over the sphere; rays that begin inside of things count as well.
"""

import argparse

import mujoco
import numpy as np

from scan3d_twin.sim.embree import can_triangulate
from scan3d_twin.sim.ray_casting import EmbreeCaster, MujocoCaster
from scan3d_twin.sim.scenes.load import load_scene, scene_names

TOLERANCE = 1e-3
"""Largest difference of two distances [m]: ten times the chords of tessellated geoms."""
BATCH = 100_000


def draw_rays(model, count, rng):
    """Return origins and directions (n, 3) of random rays in and round a scene."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    places = data.geom_xpos[np.abs(data.geom_xpos).max(axis=1) < 50]
    low, high = places.min(axis=0) - 5, places.max(axis=0) + 5
    low[2], high[2] = 0.01, 1.0
    directions = rng.standard_normal((count, 3))
    return rng.uniform(low, high, (count, 3)), directions / np.linalg.norm(
        directions, axis=1, keepdims=True
    )


def count_differences(model, count, rng):
    """Return of how many rays, of ``count``, hit or geom differ, and the distance."""
    exact, fast = MujocoCaster(model), EmbreeCaster(model)
    rays = other = apart = 0
    while rays < count:
        origins, directions = draw_rays(model, BATCH, rng)
        a = exact.cast(np.array(model.qpos0), origins, directions)
        b = fast.cast(np.array(model.qpos0), origins, directions)
        same = a.geoms == b.geoms
        rays += BATCH
        other += int((~same).sum())
        hit = same & (a.geoms >= 0)
        apart += int((np.abs(a.distances[hit] - b.distances[hit]) > TOLERANCE).sum())
    return rays, other, apart


def main():
    """Print one line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=scene_names())
    parser.add_argument("--rays", type=int, default=1_000_000)
    options = parser.parse_args()
    for name in options.scenes:
        model = load_scene(name).model
        if model.nq > 0 or not can_triangulate(model):
            print(f"{name:30} moving or not of triangles: MuJoCo alone")
            continue
        rays, other, apart = count_differences(model, options.rays, np.random.default_rng(1))
        per = 1e4 / rays
        print(f"{name:30} per 10^4: {per * other:.3f} other geoms, {per * apart:.3f} distances")


if __name__ == "__main__":
    main()
