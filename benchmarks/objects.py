"""Full tours of objects of many kinds, on an open floor and in a room.

``python benchmarks/objects.py [--first 0] [--count 20] [--cases [NAME ...]] [--rooms none 5x5]
[--seeds 3] [--first-seed 1000] [--planners fisher] [--jobs 1] [--peer PYTHON] [--out runs/objects]
[--json]`` prints a line per run on standard error, then one object {name: {value, unit, peer,
runs}}, for each room, for each class of objects in it and for each case. The objects are those of
``object_shapes.py``; indices 0 to 19 are for work, 20 to 39 for the final figures.

Each object meets a robot and a sensor of its own: the run of object ``i`` at ``--first-seed`` s has
the seed 1000 s + i, in either room and by every planner; the cases are numbered from 900 on. A
share of successes is thus one over robots, not that of one robot.

With several ``--planners`` (those of ``twin planners``, with the preset `best`) each has its own
figures, and the others are compared with the first: the ratio of the times to the same coverage,
and ``done_in_time``, the share of runs that have covered 95 % with every error within epsilon by
the time at which the first one's run of that scene and seed ends (``done_in_time_p``: sign test
over the runs in which only one of both has).

A run succeeds when every registration error is at most epsilon. A body of revolution on an open
floor has no observable yaw about its axis, so it is counted apart, in ``none_revolution_kept``: a
view beyond epsilon is accepted there if the registration reported an open direction and its error
is at most three times what it expected.

Runs are those of ``twin bench``, which writes each to a journal in ``--out`` as it ends; the same
command continues with the runs that are missing. After a change of the code take another folder.
``--peer`` is the Python of another build, which runs the same scene files; compared is the
simulated time until both reach the same coverage, the smaller of both final ones, over the runs in
which both reach 80 % with all errors within epsilon: the median over objects of the median over
seeds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import tomli_w
from object_shapes import MESH_CASES, make_object, place_on_floor
from scipy import stats

from scan3d_twin.sim.room import NO_ROOM, parse_room
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.walls import add_walls

Row = dict[str, Any]
REACHED = 0.80
"""Coverage from which the times of two builds are compared."""
DONE = 0.95
"""Coverage from which a run is done when planners are compared at equal time."""
EXPECTED_FACTOR = 3.0
"""Error of an open direction in units of the expected one that is accepted."""
SEED_STRIDE = 1000
"""Seeds from one ``--first-seed`` to the next: more than there are objects and cases."""
FIRST_CASE = 900
"""Number of the first case."""
SPAWN = -1.7
"""Where the robot starts in the scenes of boxes, along x [m]."""
Placed = tuple[str, tuple[float, float, float], tuple[float, float, float]]
"""Name of a box, its lowest and its highest corner [m]."""


@dataclass(frozen=True)
class Subject:
    """One thing to digitise, in one room.

    Attributes:
        kind: Class of the object, or name of the case.
        room: Its surroundings.
        name: Name of its scene file.
        index: Number of the object or case; with the seed asked for it determines the robot.
        target: Name of the target that is asked for; empty for the most salient one.
    """

    kind: str
    room: str
    name: str
    index: int
    target: str = ""

    def list_seeds(self, first: int, count: int) -> list[int]:
        """Return the run's seed for each of the ``count`` seeds from ``first`` on."""
        return [SEED_STRIDE * seed + self.index for seed in range(first, first + count)]


BOX_CASES: dict[str, tuple[tuple[Placed, ...], float, str]] = {
    "at_wall": ((("target", (0.0, -0.35, 0.0), (0.4, 0.35, 0.7)),), 0.4, ""),
    "two_near": (
        (
            ("target_a", (0.0, -0.5, 0.0), (0.35, -0.05, 0.5)),
            ("target_b", (0.05, 0.05, 0.0), (0.35, 0.5, 0.7)),
        ),
        0.0,
        "",
    ),
    "two_near_one": (
        (
            ("target_a", (0.0, -0.5, 0.0), (0.35, -0.05, 0.5)),
            ("target_b", (0.05, 0.05, 0.0), (0.35, 0.5, 0.7)),
        ),
        0.0,
        "target_b",
    ),
}
"""Scenes of boxes by name: the boxes, where a wall stands behind them [m] (0 for the room's own
place), and the target that is asked for."""


def write_object(folder: Path, index: int, room: str) -> Subject:
    """Write the scene of object ``index``."""
    kind, mesh = make_object(index)
    subject = Subject(kind, room, f"{kind}_{index:02d}_{room}", index)
    _write_mesh_scene(folder / f"{subject.name}.xml", mesh, room)
    return subject


def write_case(folder: Path, case: str, room: str) -> Subject:
    """Write the scene of a named ``case``."""
    target = BOX_CASES[case][2] if case in BOX_CASES else ""
    index = FIRST_CASE + (*MESH_CASES, *BOX_CASES).index(case)
    subject = Subject(case, room, f"{case}_{room}", index, target)
    path = folder / f"{subject.name}.xml"
    if case in MESH_CASES:
        _write_mesh_scene(path, place_on_floor(MESH_CASES[case]()), room)
    else:
        path.write_text(_box_scene(case, room).to_xml(), encoding="utf-8")
    return subject


def _write_mesh_scene(path: Path, mesh: Any, room: str) -> None:
    """Write the scene that ``--scene`` makes of ``mesh``, as MJCF that older builds read too."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{path.stem}.ply"
        mesh.export(file)
        scene = load_scene(str(file), 1.0, room)
    path.write_text(scene.spec.to_xml(), encoding="utf-8")


def _box_scene(case: str, room: str) -> Any:
    """Return the ``MjSpec`` of a case of boxes: in its room, or before a wall of 10 m."""
    # Add boxes, floor, light and spawn
    boxes, wall, _ = BOX_CASES[case]
    spec = mujoco.MjSpec()
    spec.modelname = case
    box, plane = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE
    for name, low, high in boxes:
        middle, half = (np.array(low) + high) / 2, (np.array(high) - low) / 2
        spec.worldbody.add_geom(
            name=name, type=box, pos=middle, size=half, rgba=[0.8, 0.75, 0.6, 1]
        )
    spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 0.1], rgba=[0.5, 0.5, 0.5, 1])
    spec.worldbody.add_light(pos=[0, 0, 3], dir=[0.3, 0, -1])
    spec.worldbody.add_site(name="spawn", pos=[SPAWN, 0, 0], group=4)
    spec.add_text(name="scan3d.tour", data="full")

    # Add the surroundings
    size = parse_room(room)
    if size is not None:
        width, depth = size
        ahead = wall or depth / 2
        add_walls(spec, (depth - ahead, ahead, width / 2, width / 2))
    elif wall:
        spec.worldbody.add_geom(
            name="wall", type=box, pos=[wall + 0.05, 0, 1.25], size=[0.05, 5, 1.25]
        )
    return spec


def run(python: str, folder: Path, subjects: list[Subject], options: argparse.Namespace) -> None:
    """Run all ``subjects`` by the build of ``python``; ``folder`` holds the journal."""
    # Describe the experiment
    scenes = options.out.resolve() / "scenes"
    variants, grids = {}, []
    for planner, subject in product(options.planners, subjects):
        label = f"{planner}-{subject.target}" if subject.target else planner
        run_options = {"preset": "best", "target": subject.target}
        variants[label] = {"planner": planner, "run": run_options}
        grids += [
            {
                "scenes": [str(scenes / f"{subject.name}.xml")],
                "variants": [label],
                "seeds": 1,
                "first_seed": seed,
            }
            for seed in subject.list_seeds(options.first_seed, options.seeds)
        ]
    common = {"tour": "full", "planning": {"epsilon": options.epsilon / 1e3}}
    experiment = {"description": "objects", "options": common, "variants": variants, "grids": grids}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "objects.toml").write_text(tomli_w.dumps(experiment), encoding="utf-8")

    # Run what is missing
    command = [str(Path(python).parent / "twin"), "bench", str(folder.resolve() / "objects.toml")]
    command += ["--jobs", str(options.jobs), "--out", str(folder.resolve())]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL, env=environment)


def read_rows(folder: Path, subjects: list[Subject], options: argparse.Namespace) -> list[Row]:
    """Return the records of the ``subjects`` in the journal of ``folder``, with their subjects."""
    known = {
        (subject.name, seed): subject
        for subject in subjects
        for seed in subject.list_seeds(options.first_seed, options.seeds)
    }
    rows: dict[tuple[str, str, int], Row] = {}
    for path in sorted(folder.glob("journal*.jsonl")):
        for line in path.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            subject = known.get((row["scene"], row["seed"]))
            if subject is not None and row["planner"] in options.planners:
                rows[row["planner"], row["scene"], row["seed"]] = {**row, "subject": subject}
    found = list(rows.values())
    if len({row["code"] for row in found}) > 1:
        print(f"do not quote this: the runs in {folder} used several versions", file=sys.stderr)
    return found


def summarise(name: str, rows: list[Row]) -> dict[str, Row]:
    """Return the figures of ``rows`` by name."""
    coverage = [row["coverage"] for row in rows]
    figures = {
        "success": (np.mean([row["success"] for row in rows]), "share"),
        "coverage_mean": (np.mean(coverage), "share"),
        "coverage_min": (np.min(coverage), "share"),
        "f20": (np.mean([row["f20"] for row in rows]), "share"),
        "time": (np.mean([row["duration"] or 0.0 for row in rows]), "s"),
        "views": (np.mean([row["views"] for row in rows]), "views"),
    }
    return {
        f"{name}_{key}": _figure(float(value), unit, "truth", len(rows))
        for key, (value, unit) in figures.items()
    }


def _figure(value: float, unit: str, peer: str, runs: int) -> Row:
    return {"value": round(value, 4), "unit": unit, "peer": peer, "runs": runs}


def keeps_word(row: Row) -> bool:
    """Return whether each error is within epsilon, or open, reported and as large as expected."""
    steps = row["steps"][1:]
    return len(steps) > 0 and all(_is_kept(step, row["epsilon"]) for step in steps)


def _is_kept(step: Row, epsilon: float) -> bool:
    error, expected = step["error"], step["expected"]
    if error is not None and error <= epsilon:
        return True
    known = error is not None and expected is not None and bool(step.get("open_directions"))
    return known and error <= EXPECTED_FACTOR * expected


def is_round(row: Row) -> bool:
    """Return whether nothing but odometry shows the yaw of ``row``'s views."""
    return row["subject"].room == NO_ROOM and row["subject"].kind in ("revolution", "pole")


def compare_times(ours: Iterable[Row], theirs: Iterable[Row]) -> tuple[float, int, int]:
    """Return the median ratio of the times to the same coverage, and its objects and runs."""
    peers = {(row["scene"], row["seed"]): row for row in theirs}
    ratios: dict[str, list[float]] = {}
    for row in ours:
        peer = peers.get((row["scene"], row["seed"]))
        if peer is not None and all(
            each["success"] and each["coverage"] >= REACHED for each in (row, peer)
        ):
            common = min(row["coverage"], peer["coverage"])
            times = [_time_to(each, common) for each in (row, peer)]
            ratios.setdefault(row["scene"], []).append(times[0] / times[1])
    if not ratios:
        return float("nan"), 0, 0
    medians = [float(np.median(each)) for each in ratios.values()]
    return float(np.median(medians)), len(ratios), sum(len(each) for each in ratios.values())


def compare_done_in_time(own: list[Row], first: list[Row], peer: str) -> dict[str, Row]:
    """Return the share of ``own`` runs that are done by the time at which the peer's end."""
    ends = {(row["scene"], row["seed"]): row for row in first}
    pairs = [(row, ends[row["scene"], row["seed"]]) for row in own]
    done = [is_done(row, end["duration"] or 0.0) for row, end in pairs]
    peers = [is_done(end, end["duration"] or 0.0) for _, end in pairs]
    better = sum(b and not a for a, b in zip(done, peers, strict=True))
    worse = sum(a and not b for a, b in zip(done, peers, strict=True))
    p = stats.binomtest(better, better + worse).pvalue if better + worse else 1.0
    return {
        "done_in_time": _figure(float(np.mean(done)), "share", peer, len(done)),
        "done_in_time_p": _figure(float(p), "p of no difference", peer, better + worse),
    }


def is_done(row: Row, time: float) -> bool:
    """Return whether ``row`` has covered ``DONE`` by ``time`` [s], each error within epsilon."""
    steps = [step for step in row["steps"] if step["time"] <= time]
    within = all(
        step["error"] is not None and step["error"] <= row["epsilon"] for step in steps[1:]
    )
    return within and any(step["coverage"] >= DONE for step in steps)


def _time_to(row: Row, coverage: float) -> float:
    """Return the simulated time [s] until ``row``'s run covered as much as ``coverage``."""
    return float(next(s["time"] for s in row["steps"] if s["coverage"] >= coverage - 1e-9))


def format_row(row: Row) -> str:
    """Return one line about a run."""
    worst = "-" if row["max_error"] is None else f"{1e3 * row['max_error']:.1f} mm"
    return (
        f"{row['planner']} {row['scene']} seed {row['seed']}: {'ok' if row['success'] else 'NO'}, "
        f"{row['views']} views, {row['duration'] or 0.0:.0f} s, worst error {worst}, coverage "
        f"{row['coverage']:.3f}, F@20 {row['f20']:.3f}, {row['stop']}"
    )


def compare_planners(rows: list[Row], planners: list[str]) -> dict[str, Row]:
    """Return the figures of each planner, and its times over those of the first."""
    figures: dict[str, Row] = {}
    by_name = {name: [row for row in rows if row["planner"] == name] for name in planners}
    first = by_name[planners[0]]
    for name, own in by_name.items():
        found = collect_figures(own)
        ratio, objects, runs = compare_times(own, first)
        found["time_to_same_coverage"] = _figure(ratio, "ratio", planners[0], runs)
        found["time_to_same_coverage_objects"] = _figure(objects, "scenes", planners[0], runs)
        found.update(compare_done_in_time(own, first, planners[0]))
        figures.update((f"{name}_{key}", figure) for key, figure in found.items())
    return figures


def collect_figures(rows: list[Row]) -> dict[str, Row]:
    """Return the figures of all rooms, classes and cases, and of bodies of revolution apart."""
    figures: dict[str, Row] = {}
    for room in sorted({row["subject"].room for row in rows}):
        inside = [row for row in rows if row["subject"].room == room]
        classes = {row["subject"].kind for row in inside}
        observable = [row for row in inside if not is_round(row)]
        if len(classes) > 1 and observable:
            figures.update(summarise(f"{room}_all", observable))
        for kind in sorted(classes):
            own = [row for row in inside if row["subject"].kind == kind]
            figures.update(summarise(f"{room}_{kind}", own))
            if is_round(own[0]):
                kept = float(np.mean([keeps_word(row) for row in own]))
                figures[f"{room}_{kind}_kept"] = _figure(kept, "share", "truth", len(own))
    return figures


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--cases", nargs="*", choices=(*MESH_CASES, *BOX_CASES))
    parser.add_argument("--rooms", "--room", nargs="+", default=["none", "5x5"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--epsilon", type=float, default=10.0, help="[mm]")
    parser.add_argument("--planners", nargs="+", default=["fisher"])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--peer", help="Python of another build")
    parser.add_argument("--out", type=Path, default=Path("runs/objects"))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    # Write the scenes
    scenes = options.out / "scenes"
    scenes.mkdir(parents=True, exist_ok=True)
    if options.cases is None:
        indices = range(options.first, options.first + options.count)
        subjects = [write_object(scenes, k, room) for room in options.rooms for k in indices]
    else:
        cases = options.cases or (*MESH_CASES, *BOX_CASES)
        subjects = [write_case(scenes, case, room) for room in options.rooms for case in cases]

    # Run both builds
    run(sys.executable, options.out / "ours", subjects, options)
    rows = read_rows(options.out / "ours", subjects, options)
    several = len(options.planners) > 1
    figures = compare_planners(rows, options.planners) if several else collect_figures(rows)
    for row in rows:
        print(format_row(row), file=sys.stderr)
    if options.peer is not None:
        run(options.peer, options.out / "peer", subjects, options)
        theirs = read_rows(options.out / "peer", subjects, options)
        ratio, objects, runs = compare_times(rows, theirs)
        figures["time_to_same_coverage"] = _figure(ratio, "ratio", options.peer, runs)
        figures["time_to_same_coverage_objects"] = _figure(objects, "scenes", options.peer, runs)
        figures.update(
            (f"peer_{name}", {**figure, "peer": options.peer})
            for name, figure in collect_figures(theirs).items()
        )

    # Print the figures
    if options.json:
        print(json.dumps(figures, indent=1))
        return
    for name, figure in figures.items():
        print(f"{name:40s} {figure['value']:10.4f} {figure['unit']:6s} ({figure['runs']} runs)")


if __name__ == "__main__":
    main()
