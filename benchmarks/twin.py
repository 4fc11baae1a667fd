"""Speed of the twin against named peers, measured in turns in one process.

Times are CPU times of this process on one thread, so that other programs matter little; values are
medians of ``--runs`` rounds, with each peer measured in every round. The scenes are
``three_boxes`` and ``clutter_100``, the robot turns at 5 deg/s. Peers: MuJoCo's physics alone
(``mj_step`` in C), ``mj_multiRay`` from one frozen pose, ``Batch.ray``, and PyBullet with a
two-wheeled robot at 240 Hz and a frozen ideal scan (dependency group ``bench``; its row is null
without it). ``stream`` reads line by line, as the closed loop does; the other loops read a sweep
at once.
Run: ``python benchmarks/twin.py [--runs 9] [--json]``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import mujoco
import numpy as np

from scan3d_twin.devices.urg.device import URG04LX
from scan3d_twin.sim.config import LidarModelConfig, TwinConfig
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.lidar.scanner import CHUNK, Scanner
from scan3d_twin.sim.ray_casting import MujocoCaster, choose_caster
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.scene import Scene

LINES = 40
"""Lines per turn of the closed loops; 4 s of simulated time."""
IMAGE_LINES = 240
RATE = math.radians(5)
STEPS_PER_LINE = 50

Task = Callable[[], object]


def interleaved(tasks: dict[str, Task], runs: int) -> dict[str, list[float]]:
    """Return the CPU times [s] of ``runs`` rounds of ``tasks``, after one round to warm up."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for turn in range(runs + 1):
        for name, task in tasks.items():
            started = time.process_time()
            task()
            if turn:
                times[name].append(time.process_time() - started)
    return times


def ratio(times: dict[str, list[float]], over: str, under: str) -> float:
    """Return the median over the rounds of ``over`` / ``under``."""
    return float(np.median(np.array(times[over]) / np.array(times[under])))


def loops(stack: ExitStack) -> dict[str, Task]:
    """Return the closed loops: physics alone, and with a line every 100 ms."""
    tasks: dict[str, Task] = {}
    for rays in (1, 5):
        config = TwinConfig(lidar=LidarModelConfig(sub_rays=rays))
        robot, _ = stack.enter_context(open_sim("three_boxes", 0, config))
        robot.base.set_velocity(0.0, RATE)
        robot.clock.sleep(1.0)
        lidar: Any = robot.lidar
        tasks[f"{rays}ray"] = lambda lidar=lidar: lidar.read_sweep(LINES)
        tasks[f"{rays}ray_stream"] = lambda lidar=lidar: [
            lidar.read_line(1.0) for _ in range(LINES)
        ]
    robot, _ = stack.enter_context(open_sim("three_boxes", 0))
    robot.base.set_velocity(0.0, RATE)
    robot.clock.sleep(1.0)
    world: Any = robot.base
    model, data = world._world.model, world._world.data  # noqa: SLF001 - the physics alone
    tasks["physics"] = lambda: mujoco.mj_step(model, data, nstep=LINES * STEPS_PER_LINE)
    return tasks


def images(scene: Scene) -> dict[str, Task]:
    """Return a sweep's whole image from per-beam poses, and all its rays from one frozen pose."""
    tasks: dict[str, Task] = {}
    for rays in (1, 5):
        config = LidarModelConfig(sub_rays=rays)
        rng = np.random.default_rng(0)
        caster = choose_caster(scene.model)
        spec, sensor = URG04LX.spec("usb"), URG04LX.sensor
        scanner = Scanner(scene.model, "create2", spec, config, caster, rng, sensor)
        tasks[f"image_{rays}ray"] = lambda scanner=scanner: image(scanner)
    tasks["image_multiray"] = multiray(scene, scanner)
    return tasks


def image(scanner: Scanner) -> None:
    """Compute the readings of a sweep on the spot, each beam from its own pose."""
    n = scanner.spec.n_beams
    for first in range(0, IMAGE_LINES, CHUNK):
        numbers = np.arange(first, first + CHUNK)
        times = 0.1 * numbers[:, None] + scanner.spec.beam_times
        positions, rotations = poses(times)
        rngs = [np.random.default_rng([0, number]) for number in numbers]
        draws = Draws.of(rngs, n, scanner.config)
        scanner.measure(np.empty(0), positions, rotations, draws, np.zeros(CHUNK))


def poses(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lidar's places and attitudes at ``times`` (...) [s]."""
    c, s = np.cos(RATE * times - 1.0), np.sin(RATE * times - 1.0)
    zero, one = np.zeros_like(c), np.ones_like(c)
    rotations = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1)
    positions = np.stack([0.05 * c - 0.9, 0.05 * s, 0.3 * one], axis=-1)
    return positions, rotations.reshape(*times.shape, 3, 3)


def multiray(scene: Scene, scanner: Scanner) -> Task:
    """Return the same number of rays by ``mj_multiRay``, from one pose."""
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_forward(model, data)
    times = 0.1 * np.arange(IMAGE_LINES)[:, None] + scanner.spec.beam_times
    positions, rotations = poses(times)
    rays = np.einsum("mnij,nj->mni", rotations, scanner.beams).ravel()
    count = rays.size // 3
    geoms, distances = np.zeros(count, np.int32), np.zeros(count)
    origin = positions[0, 0]
    return lambda: mujoco.mj_multiRay(
        model, data, origin, rays, None, True, -1, geoms, distances, None, count, 10.0
    )


def casters(scene: Scene) -> dict[str, Task]:
    """Return a line of rays in a crowded scene by the automatic caster and by ``Batch.ray``."""
    scanner = Scanner(
        scene.model,
        "create2",
        URG04LX.spec("usb"),
        LidarModelConfig(),
        choose_caster(scene.model),
        np.random.default_rng(0),
        URG04LX.sensor,
    )
    positions, rotations = poses(scanner.spec.beam_times)
    directions = np.einsum("nij,nj->ni", rotations, scanner.beams)
    kinds = {"crowded": scanner.caster, "crowded_batch": MujocoCaster(scene.model)}
    nothing = np.empty(0)
    return {
        name: lambda caster=caster: [caster.cast(nothing, positions, directions) for _ in range(20)]
        for name, caster in kinds.items()
    }


def pybullet_loop() -> Task | None:
    """Return PyBullet's loop at 240 Hz with an ideal scan from a frozen pose; None without it."""
    try:
        import pybullet as p
    except ImportError:
        return None
    client = p.connect(p.DIRECT)
    p.setGravity(0, 0, -9.81, physicsClientId=client)
    p.setTimeStep(1 / 240, physicsClientId=client)
    build_pybullet_scene(p)
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(URDF)
        file.flush()
        robot = p.loadURDF(file.name, [-0.9, 0, 0.04])
    for joint, speed in ((0, -RATE * 0.1175 / 0.036), (1, RATE * 0.1175 / 0.036)):
        p.setJointMotorControl2(robot, joint, p.VELOCITY_CONTROL, targetVelocity=speed, force=1)
    angles = (np.arange(44, 726) - 384) * math.tau / 1024

    def line() -> None:
        for _ in range(24):
            p.stepSimulation()
        place, quaternion = p.getBasePositionAndOrientation(robot)
        matrix = np.array(p.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
        fan = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1) @ matrix.T
        origin = np.array(place) + np.array([0, 0, 0.3])
        hits = p.rayTestBatch([origin] * len(fan), origin + 4.095 * fan, numThreads=1)
        np.array([hit[2] for hit in hits])

    return lambda: [line() for _ in range(LINES)]


def build_pybullet_scene(p: Any) -> None:
    """Put the boxes and planes of ``three_boxes`` into PyBullet's world."""
    model = load_scene("three_boxes").model
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=list(model.geom_size[geom]))
        else:
            shape = p.createCollisionShape(p.GEOM_PLANE)
        p.createMultiBody(0, shape, basePosition=list(model.geom_pos[geom]))


URDF = """<robot name="two_wheels">
  <link name="base"><inertial><mass value="3.4"/><inertia ixx=".03" iyy=".03" izz=".04"
    ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 .02"/><geometry>
    <cylinder radius=".165" length=".06"/></geometry></collision>
    <collision><origin xyz=".13 0 -.022"/><geometry><sphere radius=".014"/></geometry></collision>
  </link>
  <link name="left"><inertial><mass value=".15"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0"
    ixz="0" iyz="0"/></inertial><collision><geometry><sphere radius=".036"/></geometry></collision>
  </link>
  <link name="right"><inertial><mass value=".15"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0"
    ixz="0" iyz="0"/></inertial><collision><geometry><sphere radius=".036"/></geometry></collision>
  </link>
  <joint name="l" type="continuous"><parent link="base"/><child link="left"/><axis xyz="0 1 0"/>
    <origin xyz="0 .1175 0"/></joint>
  <joint name="r" type="continuous"><parent link="base"/><child link="right"/><axis xyz="0 1 0"/>
    <origin xyz="0 -.1175 0"/></joint>
</robot>"""
"""As simple a robot as drives: two wheels and a skid, without suspension, mast or errors."""


def measure(runs: int) -> dict[str, dict[str, Any]]:
    """Return all rows."""
    rows: dict[str, dict[str, Any]] = {}

    def row(name: str, value: float | None, unit: str, peer: str | None) -> None:
        rows[name] = {"value": value, "unit": unit, "peer": peer, "runs": runs}

    with ExitStack() as stack:
        tasks = loops(stack)
        bullet = pybullet_loop()
        if bullet is not None:
            tasks["pybullet"] = bullet
        times = interleaved(tasks, runs)
    for rays in (1, 5):
        alone = "mj_step alone"
        row(f"rtf_{rays}ray_over_physics", ratio(times, "physics", f"{rays}ray"), "ratio", alone)
        stream = ratio(times, "physics", f"{rays}ray_stream")
        row(f"rtf_{rays}ray_stream_over_physics", stream, "ratio", alone)
        row(f"rtf_{rays}ray", 0.1 * LINES / float(np.median(times[f"{rays}ray"])), "x", None)
    value = ratio(times, "pybullet", "1ray") if bullet is not None else None
    row("vs_pybullet_240hz", value, "ratio", "PyBullet 240 Hz, frozen ideal scan")
    times = interleaved(casters(load_scene("clutter_100")), runs)
    row("crowded_caster_ratio", ratio(times, "crowded_batch", "crowded"), "ratio", "Batch.ray")
    times = interleaved(images(load_scene("three_boxes")), runs)
    for rays in (1, 5):
        row(f"image_{rays}ray_ms", 1e3 * float(np.median(times[f"image_{rays}ray"])), "ms", None)
    frozen = ratio(times, "image_1ray", "image_multiray")
    row("image_vs_multiray", frozen, "ratio", "mj_multiRay, frozen pose")
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = measure(options.runs)
    if options.json:
        print(json.dumps(rows))
        return
    for name, each in rows.items():
        value = "not measured" if each["value"] is None else f"{each['value']:.3g}"
        print(f"{name:28} {value:>12} {each['unit']:6} {each['peer'] or ''}")


if __name__ == "__main__":
    main()
