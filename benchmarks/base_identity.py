"""How surely the driver tells a Create 1 from a Create 2, on slow and on bad lines.

    python benchmarks/base_identity.py [--trials 1000] [--corrupt 0 0.001 0.01] [--latency 0 150]

Each trial connects to an emulated base at rest, in virtual time. Latencies are in ms. The table
counts wrong names (none may be), refusals (``LinkError`` with the evidence; the base then has to be
opened with its model stated), and the longest time until an answer.
"""

from __future__ import annotations

import argparse
from collections import Counter
from itertools import product

import numpy as np

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.types import Hazards, Odometry, Pose2
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, PERIOD, Model
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.identification import find_base
from scan3d_twin.devices.create.model import CREATE2 as SPEC
from scan3d_twin.devices.links.line_model import Faults, Line, Wire


class RestingBase:
    """A ``DriveBase`` that stands, and the ``Clock`` that it follows."""

    spec: BaseSpec = SPEC

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        """See ``Clock.now``."""
        return self.time

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``."""
        self.time += max(0.0, seconds)

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``."""
        return linear, angular

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``."""
        return self._sample(int(self.time / PERIOD + 1e-6))

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        first, last = int(stamp / PERIOD + 1e-6), int(self.time / PERIOD + 1e-6)
        return tuple(self._sample(number) for number in range(first, last + 1))

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return Hazards()

    def _sample(self, number: int) -> Odometry:
        return Odometry(number * PERIOD, Pose2(), np.zeros((3, 3)))


def connect(
    model: Model, corrupt: float, latency: float, seed: int, stated: Model | None = None
) -> tuple[str, float]:
    """Return what became of one connection, and how long that took [s]."""
    base = RestingBase()
    line = Line(CreateEmulator(base, model), Faults(corrupt, corrupt, corrupt), seed, latency)
    wire = Wire(line, base)
    try:
        found = find_base(wire, base, stated).model
        answer = "right" if found is model else "wrong"
    except LinkTimeoutError:
        answer = "no answer"
    except LinkError:
        answer = "refused"
    return answer, base.now()


def main() -> None:
    """Print one line for each model, share of corrupted bytes and latency."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--corrupt", type=float, nargs="+", default=[0.0, 0.001, 0.01])
    parser.add_argument("--latency", type=float, nargs="+", default=[0.0, 50.0, 100.0, 150.0])
    parser.add_argument("--stated", action="store_true", help="state the model, as --robot does")
    options = parser.parse_args()

    print("model    corrupt  latency   right  wrong  refused  no answer   median   99 %    max")
    for model, corrupt, latency in product((CREATE1, CREATE2), options.corrupt, options.latency):
        stated = model if options.stated else None
        trials = [
            connect(model, corrupt, latency / 1e3, seed, stated)
            for seed in range(1000, 1000 + options.trials)
        ]
        counts, times = Counter(answer for answer, _ in trials), [time for _, time in trials]
        print(
            f"{model.name}  {corrupt:7g}  {latency:4.0f} ms  {counts['right']:6d} "
            f"{counts['wrong']:6d} {counts['refused']:8d} {counts['no answer']:10d}"
            f"   {np.median(times):4.2f} s  {np.quantile(times, 0.99):4.2f} s {max(times):4.2f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
