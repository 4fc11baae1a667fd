"""Finding out which RPLIDAR is on a line, whatever it was doing."""

import numpy as np
import pytest
from virtual import VirtualClock
from virtual_room import TurningLidar

from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.codec import Command
from scan3d_twin.devices.rplidar.device import RPLIDAR_A1, RPLIDAR_C1, RPLIDAR_S2
from scan3d_twin.devices.rplidar.driver import RplidarLidar
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.rplidar.model import A1, C1, S2
from scan3d_twin.devices.rplidar.probe import PROBE, recognise_rplidar
from scan3d_twin.real.probe import find_lidar

REQUESTS = (
    codec.encode_request(Command.SCAN),
    codec.encode_express_scan(1),
    codec.encode_request(Command.RESET),
    codec.encode_conf_request(0x71, 1)[:4],
    b"\nQT\nVV\n",
)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("model", [A1, C1, S2])
def test_each_is_recognised_in_time_and_can_be_opened_then(model, seed):
    rng, clock = np.random.default_rng(seed), VirtualClock()
    clock.time = 1.0 + rng.random()
    mode = next(iter(model.modes.values()))
    device = RplidarEmulator(TurningLidar(clock, model, mode), model)
    line = Line(device, Faults(junk=rng.bytes(int(rng.integers(0, 300)))), seed)
    for request in REQUESTS:
        if rng.random() < 0.3:
            device.receive(request, clock.now())
            clock.sleep(rng.random())
    started = clock.now()
    assert find_lidar(lambda: Wire(line, clock), clock) == model.name
    assert clock.now() - started < 5.5
    lidar = RplidarLidar(lambda: Wire(line, clock), clock, model, (mode,))
    lidar.close()


@pytest.mark.parametrize("left", ["a5 82", "a5 a5 84 06 71 00", "a5 84 ff"])
def test_one_that_waits_for_the_rest_of_a_request_is_recognised(left):
    clock = VirtualClock()
    device = RplidarEmulator(TurningLidar(clock, A1, A1.modes["express"]), A1)
    device.receive(bytes.fromhex(left), clock.now())
    assert find_lidar(lambda: Wire(Line(device), clock), clock) == A1.name
    assert clock.now() < 2.0


def test_what_is_no_rplidar_that_is_known_is_not_taken_for_one():
    reply = codec.encode_reply(
        codec.ReplyType.INFO, codec.DeviceInfo(0x41, (1, 1), 18, bytes(16)).encode()
    )
    assert recognise_rplidar(b"\xa5" + reply) == "rplidar_c1"
    assert recognise_rplidar(reply[:-1]) is None
    assert recognise_rplidar(reply.replace(b"\x41", b"\x31")) is None
    assert recognise_rplidar(b"QT\n00P\n\n") is None
    assert RPLIDAR_A1.probe is RPLIDAR_C1.probe is RPLIDAR_S2.probe is PROBE
