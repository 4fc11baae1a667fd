"""Finding out which lidar is on a line, whatever it was doing."""

from __future__ import annotations

import numpy as np
import pytest
from round_scene import RoundScene
from virtual import KnownLidar, VirtualClock

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.ldrobot import model as ld
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.links.line_model import Device, Faults, Line, Wire
from scan3d_twin.devices.registry import lidar_device, lidar_names, lidar_probes
from scan3d_twin.devices.rplidar.codec import DeviceInfo, ReplyType, encode_reply
from scan3d_twin.devices.urg.codec import Request
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.real.probe import PROBE_TIMEOUT, find_lidar


def make_ld(clock: VirtualClock, rng: np.random.Generator, model: ld.LdModel) -> Device:
    """Return one that turns, or was just switched on."""
    clock.time = float(rng.choice([0.0, 20.0 + rng.random()]))
    speed = float(rng.uniform(9.9, 10.1))
    scene = RoundScene(clock, model.spec, model.sample_rate, speed)
    return LdEmulator(scene, model, usb=bool(rng.integers(2)))


def make_urg(clock: VirtualClock, rng: np.random.Generator) -> Device:
    """Return one that rests, streams, has half a request or its time, or was just switched on."""
    baud = int(rng.choice([19200, 57600, 115200]))
    usb, scip1 = bool(rng.integers(2)), rng.random() < 0.3
    emulator = UrgEmulator(KnownLidar(clock), UrgProfile(usb=usb, baud=baud, scip1=scip1))
    clock.time = float(rng.choice([0.0, 20.0 + rng.random()]))
    for request in (
        Request("MD", "0044072501000").encode(),
        Request("TM", "0").encode(),
        b"MD00",
        b"\xa5\x25\xa5\x50",
    ):
        if clock.time and rng.random() < 0.3:
            emulator.receive(request, clock.time)
    return emulator


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["urg04lx", "ld06", "ld19", "stl27l"])
def test_each_lidar_is_recognised_in_time_whatever_it_does(name: str, seed: int) -> None:
    rng, clock = np.random.default_rng(seed), VirtualClock()
    models = {"ld06": ld.LD06, "ld19": ld.LD19, "stl27l": ld.STL27L}
    device = make_ld(clock, rng, models[name]) if name in models else make_urg(clock, rng)
    line = Line(device, Faults(junk=rng.bytes(int(rng.integers(0, 300)))), seed)
    started = clock.now()
    found = find_lidar(lambda: Wire(line, clock), clock)
    assert found == {"ld06": "ld19"}.get(name, name)
    assert clock.now() - started < 6.0


def make_info(model: int) -> bytes:
    """Return what an RPLIDAR of a ``model`` byte says about itself."""
    return encode_reply(ReplyType.INFO, DeviceInfo(model, (1, 29), 7, bytes(16)).encode())


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "no byte arrives"),
        (b"hello ", "[0-9]+ bytes arrive, but from none that is known"),
        (make_info(0x31), "model byte 0x31 is that of none of RPLIDAR C1, RPLIDAR A1, RPLIDAR S2"),
        (b"\xaa\x55\xf0\x0f" + bytes(100), "in another protocol .AA 55.: a COIN-D4"),
    ],
)
def test_what_is_no_lidar_is_refused_in_time(data: bytes, reason: str) -> None:
    class Talker:
        baud = 0

        def receive(self, heard: bytes, now: float) -> None:
            assert clock.now() < PROBE_TIMEOUT + 1

        def transmit(self, now: float) -> bytes:
            self.due = getattr(self, "due", 0.0)
            if now < self.due:
                return b""
            self.due = now + 0.01
            return data

    clock = VirtualClock()
    with pytest.raises(LinkError, match=reason):
        find_lidar(lambda: Wire(Talker(), clock), clock)
    assert clock.now() < PROBE_TIMEOUT + 0.5


def test_listeners_come_first_and_no_request_could_be_another_familys() -> None:
    probes = lidar_probes()
    assert [bool(probe.request) for probe in probes] == sorted(bool(p.request) for p in probes)
    for probe in probes:
        # VV and requests for several echoes mute an URG-04LX, SS and RS change it for good
        for word in (b"VV", b"ND", b"HD", b"NE", b"SS", b"RS"):
            assert word not in probe.stop + probe.request
        # RESET and requests that set something change a lidar with binary requests
        for word in (b"\xa5\x40", b"\xa5\xf0", b"\xa5\xa8"):
            assert word not in probe.stop + probe.request
    assert len(probes) < len(lidar_names())
    assert lidar_device("ld19").probe is lidar_device("stl27l").probe
