import json
from importlib.metadata import EntryPoint, EntryPoints

from scan3d_twin.core import planning
from scan3d_twin.core.planning import list_planners
from scan3d_twin.devices.registry import BASES


def test_the_real_robot_has_no_oracle(twin):
    said = twin("real", "--planner", "oracle", "--dry-run")
    assert said.code == 2
    assert "only the twin knows" in said.err
    assert said.err.count("\n") == 1


def test_every_planner_has_a_line(twin):
    lines = twin("planners").out.splitlines()
    assert len(lines) == len(list_planners())
    assert all(len(line.split(maxsplit=1)) == 2 for line in lines)
    found = json.loads(twin("planners", "--json").out)
    assert found["oracle"].endswith("twin only.")


def test_what_cannot_be_loaded_is_listed_with_the_rest(twin, monkeypatch):
    points = EntryPoints(
        [
            EntryPoint("broken", "no_such_module:X", group)
            for group in (planning.ENTRY_POINTS, BASES)
        ]
    )
    monkeypatch.setattr(planning, "entry_points", lambda group: points.select(group=group))
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points.select(group=group))
    reason = "cannot be loaded: ModuleNotFoundError: No module named 'no_such_module'"
    said = twin("planners")
    assert said.code == 0
    assert ["broken", reason] in [line.split(maxsplit=1) for line in said.out.splitlines()]
    assert "fisher" in said.out
    assert json.loads(twin("planners", "--json").out)["broken"] == reason
    named = [line.split(maxsplit=1) for line in twin("devices").out.splitlines()]
    assert ["broken", f"[base] {reason}"] in named
    listed = json.loads(twin("devices", "--json").out)
    assert listed["broken"] == f"[base] {reason}"
    assert "urg04lx" in listed
