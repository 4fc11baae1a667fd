"""Digitise the paper's three boxes in the twin and save the model, in a few lines.

Run: .venv/bin/python examples/digitize_three_boxes.py [FOLDER]
"""

import sys
from pathlib import Path

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import digitize
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.model.fused_cloud import build_model
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.recording.ply import ply_bytes
from scan3d_twin.sim.robot import open_sim

SEED = 0


def main(folder: Path) -> None:
    config = Config(max_views=4)
    with open_sim("three_boxes", SEED) as (robot, truth):
        session = digitize(robot, make_planner("siicp"), config, SEED, Unobserved())
        model = build_model(session)
        result = evaluate(session, truth)

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.ply").write_bytes(ply_bytes(model.points, model.view))
    print(f"{len(session.views)} views, {len(model)} points: {session.stop_reason}")
    print(f"{result.coverage:.0%} of what can be covered is within 20 mm of the model")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("runs/example"))
