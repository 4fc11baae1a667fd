"""How much memory a long run takes on the robot's own computer."""

import json

from lockstep import far_drivers

from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import HazardFreeClock

HEAVY = ("scipy", "mujoco", "trimesh", "open3d", "matplotlib", "viser")
ON_THE_WAY = """
sweep.look_rate = 1.2
motion.turn_rate = 1.5
motion.speed = 0.4
"""
"""A quick look around and quick ways, with sweeps as slow as usual."""
QUICK = f"""
sweep.yaw_rate = 0.5
{ON_THE_WAY}
"""
"""Quick sweeps of some 55 lines, six times coarser than the default: what 20 views take of memory
is mostly what a run takes that is so long."""
TWENTY = """
tour = "full"
max_views = 20
planner = "fixed"
baselines.fixed_overlap = 0.92
planning.closing = "none"
"""


def digitised(folder, options):
    """Return the report of a run of the drivers alone on `three_boxes`, and what they imported."""
    with open_sim("three_boxes", 0) as (robot, _):
        clock = HazardFreeClock(robot.clock)
        base, lidar = CreateEmulator(robot.base), UrgEmulator(robot.lidar)
        wires = {"base": Wire(base, clock), "lidar": Wire(lidar, clock)}
        with far_drivers(wires, clock, folder, options.strip().splitlines()) as ended:
            assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout), ended.stderr.splitlines()[-1]


def test_twenty_views_stay_under_160_mb(tmp_path):
    report, loaded = digitised(tmp_path / "run", QUICK + TWENTY)
    assert report["views"] == 20
    assert report["peak_memory_mb"] < 160
    assert "numpy" in loaded
    assert not [name for name in HEAVY if name in loaded]


def test_sweeps_as_fine_as_usual_and_their_plans_stay_under_160_mb(tmp_path):
    report, _ = digitised(tmp_path / "run", ON_THE_WAY + "max_views = 2")
    assert report["views"] == 2
    assert report["peak_memory_mb"] < 160
