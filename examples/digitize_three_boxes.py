"""Digitise the paper's three boxes in the twin and save the model, in a few lines.

Run: .venv/bin/python examples/digitize_three_boxes.py [FOLDER]
"""

import sys
from pathlib import Path

import scan3d_twin as s3d


def main(folder: Path) -> None:
    config = s3d.Config(max_views=3)
    with s3d.open_sim("three_boxes", seed=0) as (robot, truth):
        session = s3d.digitize(robot, config)
        result = s3d.evaluate(session, truth)

    s3d.export_model(session, folder / "model.ply")
    print(f"{len(session.views)} views: {session.stop_reason}")
    print(f"{result.coverage:.0%} of what can be covered is within 20 mm of the model")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("runs/example"))
