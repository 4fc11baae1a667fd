"""How surely ``twin real --lidar auto`` names the lidar, and that what it sends harms nothing.

    python benchmarks/lidar_auto.py [--trials 50] [--lidars ld19 rplidar_c1] [--swap]

Each trial has an emulated base and an emulated lidar, each in a random state (asleep, streaming,
with half an order, just switched on), on lines with a latency of up to 20 ms, in virtual time. As
the command does with ``--robot``, it identifies the base on its own port and then looks for the
lidar on the other (``benchmarks/base_identity.py`` is about bases that are not stated).
The table counts right and wrong names, refusals, and harm: an order that moves the base or presses
its buttons, a lidar that was muted or set to another speed or bit rate, or one that its driver
cannot open afterwards. With ``--swap`` the two ports are mixed up: each trial must be refused.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from base_identity import RestingBase

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import VALID, Beams, LidarSpec, ScanLine, read_only
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, Op
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.device import Wiring
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.links.line_model import Device, Faults, Line, Wire
from scan3d_twin.devices.registry import lidar_device, lidar_names
from scan3d_twin.devices.rotating import to_elevation
from scan3d_twin.devices.rplidar import codec as rplidar
from scan3d_twin.devices.rplidar.codec import Command
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.urg.codec import Request
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.devices.urg.model import REPLY_LATENCY
from scan3d_twin.real.probe import find_lidar
from scan3d_twin.real.robot import identify_base

FIRST_SEED = 1000
MAX_LATENCY = 0.020
"""Latest that an adapter hands over what has arrived [s]: an FTDI, as shipped, after 16 ms."""
MAX_JUNK = 300
"""Most bytes that wait at the port from before."""
LONG_AGO = 20.0
"""Time since which most devices are switched on [s]."""
SAME_NAME = {"ld06": "ld19"}
"""Lidars of which no answer tells that they are not another, and the name of that."""
URG_REQUESTS = (
    Request("MD", "0044072501000").encode(),
    Request("MS", "0044072501000").encode(),
    Request("TM", "0").encode(),
    Request("BM", "").encode(),
)
RPLIDAR_REQUESTS = (
    rplidar.encode_request(Command.SCAN),
    rplidar.encode_express_scan(0),
    rplidar.encode_express_scan(1),
    rplidar.encode_request(Command.RESET),
    rplidar.encode_request(Command.GET_HEALTH),
    rplidar.encode_conf_request(0x71, 1),
    rplidar.encode_motor_rpm(600),
)
CHANGING = {Command.SET_MOTOR_RPM, Command.SET_MOTOR_PWM}
"""Commands of an RPLIDAR whose effect lasts; RESET, which bytes at a wrong bit rate may look like,
is over in 2 s."""
BASE_ORDERS = (
    bytes([Op.START]),
    bytes([Op.START, Op.SAFE]),
    bytes([Op.START, Op.FULL]),
    bytes([Op.START, Op.STREAM, 2, 7, 35]),
    bytes([Op.START, Op.SENSORS, 35]),
)


class Room:
    """A lidar, and a ``BeamStream``, that reads 2 m all round."""

    def __init__(self, clock: Clock, spec: LidarSpec, rate: float) -> None:
        self.spec = spec
        self._clock, self._rate = clock, rate
        self._taken = math.floor(clock.now() * rate)
        self._next = math.ceil(clock.now() / spec.line_period)

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        stamp = self._next * self.spec.line_period
        if self._clock.now() < stamp + REPLY_LATENCY:
            raise LinkTimeoutError("no line yet")
        self._next += 1
        count = self.spec.n_beams
        return ScanLine(stamp, read_only(np.full(count, 2.0)), read_only([VALID] * count, np.int64))

    def read_beams(self) -> Beams:
        """See ``BeamStream.read_beams``."""
        last = max(self._taken, math.floor(self._clock.now() * self._rate))
        times, self._taken = np.arange(self._taken, last) / self._rate, last
        angles = to_elevation(math.tau / self.spec.line_period * times)
        return Beams(times, angles, np.full(len(times), 2.0), np.full(len(times), VALID))


@dataclass
class Side:
    """One emulated device.

    Attributes:
        name: Its name.
        device: The device.
        is_harmed: Returns whether what it received since has harmed it.
    """

    name: str
    device: Device
    is_harmed: Callable[[], bool]


def cut(request: bytes, rng: np.random.Generator) -> bytes:
    """Return a ``request``, or its beginning, as a client leaves it that is killed."""
    return request if rng.random() < 0.7 else request[: int(rng.integers(1, len(request) + 1))]


def make_base(clock: RestingBase, rng: np.random.Generator) -> Side:
    """Return a base that was told some of ``BASE_ORDERS``."""
    model = (CREATE1, CREATE2)[rng.integers(2)]
    device = CreateEmulator(clock, model)
    for order in BASE_ORDERS:
        if rng.random() < 0.3:
            device.receive(cut(order, rng), clock.now())
    before = replace(device.outputs)
    return Side(model.name, device, lambda: device.outputs != before or device.wheels_mm != (0, 0))


def make_lidar(name: str, clock: RestingBase, rng: np.random.Generator) -> Side:
    """Return the lidar called ``name`` in a random state."""
    description = lidar_device(name)
    link = description.links[0]
    rate = description.sample_rate(link) if description.sample_rate else 0.0
    room = Room(clock, description.spec(link), rate)
    if name == "urg04lx":
        return make_urg(room, clock, rng)
    device = description.emulate(room, Wiring(usb=False))
    if isinstance(device, LdEmulator):
        return make_ld(device, clock, rng)
    assert isinstance(device, RplidarEmulator)
    return make_rplidar(device, clock, rng)


def make_urg(room: Room, clock: RestingBase, rng: np.random.Generator) -> Side:
    """Return an URG-04LX; harm is a bit rate or a sensor that no longer answers."""
    usb, is_new = bool(rng.integers(2)), rng.random() < 0.2
    baud = int(rng.choice([19200, 57600, 115200]))
    device = UrgEmulator(
        room, UrgProfile(usb, baud, scip1=rng.random() < 0.3, mute_on_multiecho=True)
    )
    if is_new:
        device.power_up(clock.now())
    for request in URG_REQUESTS:
        if rng.random() < 0.3:
            device.receive(cut(request, rng), clock.now())
    return Side("urg04lx", device, lambda: device.firmware.mute or device.firmware.baud != baud)


def make_ld(device: LdEmulator, clock: RestingBase, rng: np.random.Generator) -> Side:
    """Return a lidar of LDROBOT, which hears nothing."""
    if rng.random() < 0.3:
        device.power_up(clock.now())
    return Side("", device, lambda: False)


def make_rplidar(device: RplidarEmulator, clock: RestingBase, rng: np.random.Generator) -> Side:
    """Return an RPLIDAR; harm is a command of ``CHANGING``."""
    device.set_dtr(bool(rng.integers(2)), clock.now())
    told, heard = set[int](), set[int]()
    for request in RPLIDAR_REQUESTS:
        if rng.random() < 0.3:
            device.receive(cut(request, rng), clock.now())
            clock.sleep(rng.random())
            told.add(request[1])
    answer = device.firmware.answer

    def listen(request: rplidar.Request, now: float) -> bytes:
        heard.add(request.command)
        return answer(request, now)

    device.firmware.answer = listen  # type: ignore[method-assign]
    return Side(device.firmware.model.name, device, lambda: bool(heard & CHANGING - told))


def try_once(name: str, seed: int, *, is_swapped: bool) -> tuple[str, float, bool]:
    """Return what became of one trial, how long it took [s], and whether anything was harmed."""
    rng, clock = np.random.default_rng(seed), RestingBase()
    clock.sleep(LONG_AGO + rng.random())
    base, lidar = make_base(clock, rng), make_lidar(name, clock, rng)
    junk = Faults(junk=rng.bytes(int(rng.integers(MAX_JUNK))))
    sides = (lidar, base) if is_swapped else (base, lidar)
    lines = [Line(each.device, junk, seed, MAX_LATENCY * rng.random()) for each in sides]

    # As ``twin real --lidar auto`` does
    started = clock.now()
    try:
        identify_base(Wire(lines[0], clock), clock, base.name)
        found = find_lidar(lambda: Wire(lines[1], clock), clock)
    except LinkError:
        found = ""
    taken = clock.now() - started
    harmed = base.is_harmed() or lidar.is_harmed()
    answer = "right" if found == SAME_NAME.get(name, name) else "wrong" if found else "refused"

    # The driver opens it afterwards
    if answer == "right":
        try:
            lidar_device(found).open_driver(lambda: Wire(lines[1], clock), clock, None).close()
        except LinkError:
            harmed = True
    return answer, taken, harmed


def main() -> None:
    """Print one line for each lidar."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--lidars", nargs="+", default=list(lidar_names()))
    parser.add_argument("--swap", action="store_true")
    options = parser.parse_args()

    print("lidar       right  wrong  refused  harm   median     max")
    for name in options.lidars:
        seeds = range(FIRST_SEED, FIRST_SEED + options.trials)
        trials = [try_once(name, seed, is_swapped=options.swap) for seed in seeds]
        counts, times = Counter(answer for answer, *_ in trials), [time for _, time, _ in trials]
        print(
            f"{name:11s} {counts['right']:5d} {counts['wrong']:6d} {counts['refused']:8d} "
            f"{sum(harm for *_, harm in trials):5d}   {np.median(times):4.2f} s  "
            f"{max(times):4.2f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
