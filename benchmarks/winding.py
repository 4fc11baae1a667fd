"""Share of each object that can be seen, as its faces are wound and otherwise.

    python benchmarks/winding.py [--count 29] [--spacings 0.005 0.02 0.03] [--format stl]

For the first objects of ``object_shapes.py``: the largest change of the coverable share when all
faces, or a random 40 % of them, are turned over, for each way in which programs list the corners of
a turned face; and how far the samples of the surface move.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from object_shapes import make_object

from scan3d_twin.core.config import Config
from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.ray_casting import choose_caster
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.truth import Truth

WAYS = ([0, 2, 1], [2, 1, 0], [1, 0, 2])
"""Orders in which the corners of a face that is turned over can be listed."""
PART = 0.4
"""Share of the faces that are turned over in part."""


def measure(mesh, path, spacings):
    """Return the samples of ``mesh`` by spacing, and the share of each that can be seen."""
    mesh.export(path)
    scene = load_scene(str(path))
    truth = Truth(scene, KinematicWorld(scene.spawn), choose_caster(scene.model), lambda: None)
    samples = [truth.surface(spacing) for spacing in spacings]
    tour = Config(tour="full")
    shares = [float(find_coverable_surface(*each, truth, tour).mean()) for each in samples]
    return samples, np.array(shares)


def wind(mesh, chosen, way):
    """Return ``mesh`` with the ``chosen`` faces (m,) turned over by ``way``."""
    faces = np.where(chosen[:, None], mesh.faces[:, way], mesh.faces)
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def find_shift(ours, theirs):
    """Return how far the samples ``theirs`` are from ``ours`` at most [m]; inf if more or fewer."""
    if len(ours[0]) != len(theirs[0]):
        return np.inf
    return float(np.linalg.norm(ours[0] - theirs[0], axis=1).max())


def main():
    """Print one line for each object, and the largest change."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=29)
    parser.add_argument("--spacings", type=float, nargs="+", default=[0.005, 0.02, 0.03])
    parser.add_argument("--format", default="stl")
    options = parser.parse_args()
    worst = np.zeros(len(options.spacings))
    for index in range(options.count):
        kind, mesh = make_object(index)
        rng = np.random.default_rng(index)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"thing.{options.format}"
            samples, right = measure(mesh, path, options.spacings)
            change, moved = np.zeros(len(right)), 0.0
            for way in WAYS:
                for share in (1.0, PART):
                    turned = wind(mesh, rng.random(len(mesh.faces)) < share, way)
                    others, shares = measure(turned, path, options.spacings)
                    change = np.maximum(change, np.abs(shares - right))
                    moved = max(moved, *map(find_shift, samples, others))
        worst = np.maximum(worst, change)
        print(f"{index:3} {kind:20} {right.round(4)} {change.round(5)} {moved:.1e} m", flush=True)
    print("largest change", worst.round(5))


if __name__ == "__main__":
    main()
