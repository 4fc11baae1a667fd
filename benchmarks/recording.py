"""Cost of recording, time to open a session, and loss when the program is killed.

    python benchmarks/recording.py cost     # share of a core at 10 Hz, memory, size
    python benchmarks/recording.py open     # time to open a session of 20 views, finished and cut
    python benchmarks/recording.py kill 20  # this many runs of the twin, killed at random moments

Times are the process's own (`time.process_time`), so that other programs do not count.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
SECONDS = 300
"""Time on the robot's clock over which the cost is measured [s]: about ten views."""
PROGRAM = """
import os, sys
from scan3d_twin.api.view_saver import ViewSaver
from scan3d_twin.cli import main
def on_line(self, line):
    os.write(2, f"line {line.stamp!r}\\n".encode())
ViewSaver.on_line = on_line
sys.exit(main(sys.argv[1:]))
"""
"""The program, with the stamp of each line on standard error once the recorder has it."""


def resident() -> float:
    """Return the resident memory of this process [MB]."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(next(line for line in status.splitlines() if "VmRSS" in line).split()[1]) / 1024


def views(count: int):  # type: ignore[no-untyped-def]
    """Return a session of ``count`` views with the noise of the real lidar."""
    import synthetic

    from scan3d_twin.core.config import Config
    from scan3d_twin.core.digitize import integrate
    from scan3d_twin.core.session import Session
    from scan3d_twin.core.types import Plan, Pose2

    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session, rng = (
        Session(Config.preset("paper"), 7, hint, np.array([-1.0, 0.0])),
        np.random.default_rng(0),
    )
    for _ in range(count):
        where = Pose2(-0.4, float(rng.uniform(-0.3, 0.3)), 0.0)
        session = integrate(session, synthetic.observe(where, sigma=0.005, rng=rng))
        session = session.with_plan(Plan(where, 0.8, 0.01, False, (), "a plan"))
    return session


def cost() -> None:
    """Print what a recorder adds to a robot that reads lines at 10 Hz and drives in between."""
    from recorded import line, make_robot

    from scan3d_twin.recording.recorder import Recorder

    session = views(2)
    read = line(0.0)
    rng = np.random.default_rng(0)
    noisy = [np.round(read.ranges + 0.005 * rng.standard_normal(682), 3) for _ in range(50)]
    before = resident()
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder), time.monotonic, {})
        plain = make_robot()
        robot = recorder.attach(plain)
        spent, seen = 0.0, replace(session, views=(), plans=())
        for k in range(10 * SECONDS):
            plain.clock.sleep(0.1)
            started = time.process_time()
            recorder.on_bytes("/serial/lidar", robot.clock.now(), "<", bytes(2100))
            for _ in range(7):
                recorder.on_bytes("/serial/base", robot.clock.now(), "<", bytes(60))
            recorder.on_line(replace(read, stamp=robot.clock.now(), ranges=noisy[k % 50]))
            if k % 300 == 299:
                seen = seen.with_view(session.views[k // 300 % 2])
                recorder.on_view(seen)
                recorder.on_plan(seen.with_plan(session.plans[0]))
            spent += time.process_time() - started
        held = resident() - before
        size = recorder.path.with_name("session.mcap.part").stat().st_size
        recorder.close()
    found = {
        "core_percent": round(100 * spent / SECONDS, 2),
        "resident_mb": round(held, 1),
        "mb_per_minute": round(size / 1e6 / (SECONDS / 60), 1),
    }
    print(json.dumps(found))


def open_sessions() -> None:
    """Print how long a session of 20 views takes to open."""
    from recorded import record

    from scan3d_twin.recording.load import load_session

    session = views(20)
    with tempfile.TemporaryDirectory() as folder:
        for finish in (True, False):
            place = Path(folder) / str(finish)
            record(place, session, finish=finish)
            started = time.process_time()
            recorded = load_session(place)
            spent = time.process_time() - started
            found = {
                "finished": finish,
                "views": len(recorded.session.views),
                "size_mb": round(recorded.path.stat().st_size / 1e6, 1),
                "open_s": round(spent, 2),
            }
            print(json.dumps(found), flush=True)


def kill(count: int) -> None:
    """Kill runs at random moments, open and resume each, and compare with a run left alone."""
    scan = ["sim", "--scene", "three_boxes", "--max-views", "3", "--epsilon", "100"]
    rng, lost, same, empty = np.random.default_rng(0), [], 0, 0
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        total = len(_record_until(scan, whole, 10**9))
        for k in range(count):
            place = Path(folder) / f"run{k}"
            stamps = _record_until(scan, place, int(rng.integers(1, total)))
            lost.append(_lost(place, stamps[-1]))
            resumed = _twin(["sim", "--resume", str(place)])
            if resumed == 3:
                empty += 1
            else:
                model = (place / "model.ply").read_bytes()
                same += resumed == 0 and model == (whole / "model.ply").read_bytes()
            print(
                json.dumps({"run": k, "lost_s": round(lost[-1], 3), "resumed": resumed}), flush=True
            )
    found = {
        "runs": count,
        "most_lost_s": round(max(lost), 3),
        "model_completed_bit_by_bit": same,
        "killed_before_the_first_view": empty,
    }
    print(json.dumps(found))


def _record_until(scan: list[str], folder: Path, count: int) -> list[float]:
    """Return the stamps of the lines of a run that is killed after ``count`` of them."""
    command = [sys.executable, "-c", PROGRAM, *scan, "--out", str(folder)]
    stamps: list[float] = []
    with subprocess.Popen(command, stdout=-3, stderr=subprocess.PIPE, text=True, cwd=ROOT) as run:
        assert run.stderr is not None
        for text in run.stderr:
            if text.startswith("line "):
                stamps.append(float(text.split()[1]))
            if len(stamps) == count:
                run.kill()
    return stamps


def _lost(folder: Path, last: float) -> float:
    """Return how much of the robot's time a killed run has lost [s]."""
    from scan3d_twin.recording.load import find_session_file, read_lines

    return last - max((line.stamp for line in read_lines(find_session_file(folder))), default=0.0)


def _twin(arguments: list[str]) -> int:
    command = [sys.executable, "-m", "scan3d_twin.cli", *arguments]
    return subprocess.run(command, capture_output=True, cwd=ROOT).returncode


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "cost"
    if what == "kill":
        kill(int(sys.argv[2]) if len(sys.argv) > 2 else 20)
    else:
        {"cost": cost, "open": open_sessions}[what]()
