"""Make a mesh, digitise it all round, and print why the robot went where it went.

Run: .venv/bin/python examples/own_scene.py [FOLDER]
"""

import sys
from pathlib import Path

import trimesh

import scan3d_twin as s3d


def make_chest(path: Path) -> Path:
    """Write a chest with a lid, in metres, to ``path``; any mesh file of your own will do."""
    body = trimesh.creation.box((0.50, 0.35, 0.40))
    lid = trimesh.creation.box((0.56, 0.41, 0.06))
    lid.apply_translation((0.0, 0.0, 0.23))
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.util.concatenate([body, lid]).export(path)
    return path


def main(folder: Path) -> None:
    scene = s3d.load_scene(str(make_chest(folder / "chest.stl")))
    config = s3d.Config(tour="full", max_views=3)
    with s3d.open_sim(scene, seed=0) as (robot, _):
        session = s3d.digitize(robot, config)

    for k, (view, plan) in enumerate(zip(session.views, session.plans, strict=True)):
        here = view.T_world_scan
        print(f"view {k} from ({here.x:+.2f}, {here.y:+.2f}) m: {len(view.target)} points")
        then = f"{plan.overlap:.0%} overlap" if plan.viewpoint else "the end"
        print(f"    then {then}, because: {plan.reason}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("runs/example"))
