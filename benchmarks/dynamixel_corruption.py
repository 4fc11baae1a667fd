"""What a bad line does to the angles of a Dynamixel XL330: how many wrong ones get through.

An emulated servo turns back and forth over a line that loses, inserts and flips bytes. Printed are
the questions that had no good answer, and the angles that the driver believed although they are
wrong: by more than half a count and the motion in 1.5 ms.

    python benchmarks/dynamixel_corruption.py --bytes 100000 --corrupt 0.01
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from virtual import VirtualClock
from virtual_table import VirtualTable

from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel.driver import Xl330Turntable
from scan3d_twin.devices.dynamixel.emulated_firmware import ServoProfile
from scan3d_twin.devices.dynamixel.emulator import Xl330Emulator
from scan3d_twin.devices.links.line_model import Faults, Line, Wire

SPEED = 0.5
"""Speed of the motions [rad/s]."""
INTERVAL = 3.0
"""Time between two orders [s]."""
WRONG = 0.51 * model.COUNT + 0.0015 * SPEED
"""Error from which on an angle is wrong [rad]."""
SLICE = model.SERVICE_INTERVAL


class CountingLine(Line):
    """A line that counts its bytes in both directions."""

    carried = 0

    def _add_faults(self, data: bytes) -> bytes:
        self.carried += len(data)
        return super()._add_faults(data)


def main() -> None:
    """Print the counts of one run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--bytes", type=int, default=100_000, help="bytes to be damaged")
    parser.add_argument("--corrupt", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    # Connect, then damage the line
    clock, p = VirtualClock(), options.corrupt
    table = VirtualTable(clock)
    servo = Xl330Emulator(table, ServoProfile(baud=1_000_000))
    line = CountingLine(servo, seed=options.seed)
    driver = Xl330Turntable(lambda: Wire(line, clock), clock)
    line.faults, line.carried = Faults(drop=p, insert=p, flip=p), 0

    # Turn back and forth, and compare each angle with the truth
    wrong, worst, believed, last, turned = 0, 0.0, 0, clock.now(), -math.inf
    while line.carried * 3 * p < options.bytes:
        if clock.now() > turned + INTERVAL:
            turned = clock.now()
            driver.turn_to(math.copysign(1.0, -table.at(turned)), SPEED)
        clock.sleep(SLICE)
        driver.service()
        angle = driver.angle()
        if angle.stamp > last:
            last, believed = angle.stamp, believed + 1
            off = abs(angle.angle - table.at(angle.stamp))
            wrong, worst = wrong + (off > WRONG), max(worst, off)
            table.forget(clock.now() - 1.0)

    # Print what became of the questions
    print(
        f"{line.carried} bytes, {line.carried * 3 * p:.0f} of them damaged, {driver.bad} questions "
        f"without a good answer, {driver.stats.reconnects} reconnections"
    )
    print(
        f"wrong angles: {wrong} of {believed} believed; the largest error is "
        f"{math.degrees(worst):.3f} deg, half a count is {math.degrees(model.COUNT / 2):.3f}"
    )


if __name__ == "__main__":
    main()
