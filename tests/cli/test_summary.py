"""The last lines of a run."""

from pathlib import Path

from scan3d_twin.cli.app import COMMANDS
from scan3d_twin.cli.summary import count, next_steps, summary

REPORT = {
    "scene": "three_boxes",
    "views": 1,
    "points": 7903,
    "stop_reason": "the contour is closed",
    "sim_time_s": 74.2,
    "path_m": 2.1,
    "wall_time_s": 5.4,
    "coverage_20mm": 0.8273,
    "accuracy_mm": {"median": 3.24},
    "registration": [],
}


def test_one_is_not_many():
    assert [count(number, "view") for number in (0, 1, 2)] == ["0 views", "1 view", "2 views"]
    assert summary(REPORT, Path("run")).startswith("three_boxes: 1 view, 7903 points; the contour")


def test_the_covered_share_is_of_the_surface():
    text = summary(REPORT, Path("run"))
    assert "\nsurface: 82.7% of what the lidar can reach is covered (within 20 mm); " in text
    assert "scanned" not in text  # a word for the outline, see progress


def test_without_the_truth_nothing_is_said_of_the_surface():
    assert "surface" not in summary({**REPORT, "coverage_20mm": None}, Path("run"))


def test_the_steps_that_come_next_are_commands_of_the_program():
    title, *steps = next_steps(Path("runs/a")).splitlines()
    assert title == "next:"
    assert [step.split()[:2] for step in steps] == [
        ["twin", "view"],
        ["twin", "mesh"],
        ["twin", "sim"],
    ]
    assert {step.split()[1] for step in steps} <= set(COMMANDS)
