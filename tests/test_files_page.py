"""Each key of the files of a run is on docs/files.md, and no other."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from sessions import two_planned_views

from scan3d_twin.core.model.fused_cloud import build_model
from scan3d_twin.recording.ply import model_ply
from scan3d_twin.recording.views import view_bytes
from scan3d_twin.run.report import report_schema

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "files.md").read_text(encoding="utf-8")


def rows(heading: str, table: int = 0) -> list[list[str]]:
    """Return the cells of each row of a table below ``heading``."""
    section = PAGE.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    body = re.split(r"\n\|(?:---\|)+\n", section)[table + 1].split("\n\n")[0]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in body.splitlines()]


def documented(heading: str, table: int = 0) -> list[str]:
    """Return the names in the first column of a table below ``heading``."""
    return [name for row in rows(heading, table) for name in re.findall(r"`([^`]+)`", row[0])]


def test_the_properties_of_model_ply_are_documented_in_order():
    content = model_ply(build_model(two_planned_views(), voxel=0.05))
    header = content.split(b"end_header", 1)[0].decode()
    types = [
        (kind, name)
        for names, kind, _ in rows("`model.ply`")
        for name in re.findall(r"`(\w+)`", names)
    ]
    assert re.findall(r"property (\w+) (\w+)", header) == types


def test_the_arrays_of_a_view_are_documented_with_their_shapes():
    view = two_planned_views().views[0]
    image = view.observation.image
    own = replace(image, elevations=np.tile(image.spec.elevations + 1e-3, (image.n_lines, 1)))
    view = replace(view, observation=replace(view.observation, image=own))
    arrays = np.load(io.BytesIO(view_bytes(view)))
    assert set(arrays.files) == set(documented("`views/NNN.npz`"))
    sizes = {"L": image.n_lines, "B": image.spec.n_beams, "n": len(view.target)}
    for names, shape, _ in rows("`views/NNN.npz`"):
        stated = [part.strip() for part in shape.strip("()").split(",") if part.strip()]
        for name in re.findall(r"`(\w+)`", names):
            assert arrays[name].shape == tuple(sizes.get(each) or int(each) for each in stated)


def test_the_fields_of_a_report_are_documented():
    schema = report_schema()["properties"]
    assert documented("`report.json`") == list(schema)
    fields = schema["registration"]["items"]["properties"]
    assert documented("`report.json`", table=1) == list(fields)
