import json

from scan3d_twin.core.planning import list_planners


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
