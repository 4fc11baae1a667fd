"""``twin emulate`` with both devices streaming: does its memory grow, and do scans keep their pace?

    python benchmarks/emulator_endurance.py [--minutes 30] [--scene three_boxes]

Starts the emulator, reads both devices with this package's drivers, and prints once a minute the
emulator's memory, and the deviations of the time between two scans from 100 ms, as they arrive.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np

from scan3d_twin.devices.create.driver import open_create
from scan3d_twin.devices.links.transport import SerialTransport
from scan3d_twin.devices.urg.driver import UrgLidar
from scan3d_twin.devices.urg.model import REVOLUTION
from scan3d_twin.real.clock import RealClock
from scan3d_twin.real.robot import ServicedClock


def memory(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    (kilobytes,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(kilobytes) / 1024


def watch(pid: int, ports: dict[str, str], minutes: float) -> None:
    """Read both devices for so many ``minutes`` and print what is seen."""
    clock = ServicedClock(RealClock())
    with (
        closing(SerialTransport(ports["base_port"])) as link,
        closing(UrgLidar(lambda: SerialTransport(ports["lidar_port"]), clock)) as lidar,
    ):
        clock.attach(lidar)
        with closing(open_create(link, clock)) as base:
            clock.attach(base)
            sizes, arrivals = [memory(pid)], [clock.now()]
            print(f"start: {sizes[0]:.1f} MB", flush=True)
            for minute in range(1, round(minutes) + 1):
                while clock.now() < arrivals[0] + 60 * minute:
                    lidar.read_line(5.0)
                    arrivals.append(clock.now())
                sizes.append(memory(pid))
                off = 1e3 * np.abs(np.diff(arrivals) - REVOLUTION)
                print(
                    f"{minute:3d} min: {sizes[-1]:.1f} MB (grown by {sizes[-1] - sizes[1]:+.1f}), "
                    f"{len(off)} scans, off 100 ms by {np.median(off):.1f} ms (median), "
                    f"{np.quantile(off, 0.99):.1f} ms (99 %), {off.max():.0f} ms (max); "
                    f"damaged: lidar {lidar.bad}, base {base.bad}",
                    flush=True,
                )


def main() -> None:
    """Start the emulator, watch it and end it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--scene", default="three_boxes")
    options = parser.parse_args()
    command = [sys.executable, "-m", "scan3d_twin.cli", "emulate", "--json"]
    command += ["--scene", options.scene]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as emulator:
        assert emulator.stdout is not None
        try:
            watch(emulator.pid, json.loads(emulator.stdout.readline()), options.minutes)
        finally:
            emulator.send_signal(signal.SIGTERM)


if __name__ == "__main__":
    main()
