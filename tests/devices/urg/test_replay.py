"""A recording of a real URG-04LX (firmware 3.1.04, USB) through codec and driver.

The recording is not part of the project (LGPL): it is hokuyoaist's ``example_urg_04lx.logr/.logw``.
Put both below the folder that the variable SCAN3D_TWIN_CAPTURES names.
"""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from virtual import VirtualClock, values_of

from scan3d_twin.core.types import VALID
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg import replies as scip_replies
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.driver import UrgLidar
from scan3d_twin.devices.urg.replies import Splitter

SCAN = ScanRequest("GD", 44, 725)


def _records(path):
    """Yield (time [s], bytes) of a recording: seconds, microseconds and length, 32 bits each."""
    data, place = path.read_bytes(), 0
    while place < len(data):
        seconds, microseconds, length = struct.unpack_from(">III", data, place)
        yield seconds + microseconds * 1e-6, data[place + 12 : place + 12 + length]
        place += 12 + length


@pytest.fixture(scope="module")
def capture():
    """The bytes to the sensor and from it."""
    folder = os.environ.get("SCAN3D_TWIN_CAPTURES", "")
    found = sorted(Path(folder).rglob("example_urg_04lx.log[rw]")) if folder else []
    if len(found) != 2:
        pytest.skip("set SCAN3D_TWIN_CAPTURES to the folder with example_urg_04lx.logr and .logw")
    received, sent = (b"".join(data for _, data in _records(path)) for path in found)
    return sent, received


@pytest.fixture(scope="module")
def replies(capture):
    return [scip_replies.decode_reply(block) for block in Splitter().feed(capture[1])]


def test_the_codec_makes_every_request_of_the_recording(capture):
    requests = [scip.parse_request(line) for line in capture[0].split()]
    assert b"".join(request.encode() for request in requests) == capture[0]
    assert SCAN.request() == requests[-1]
    assert [request.command for request in requests[:3]] == ["VV", "VV", "PP"]


def test_the_codec_makes_every_reply_of_the_recording(capture, replies):
    made = b""
    for reply in replies:
        if reply.echo[:2] in ("VV", "PP", "II"):
            lines = [scip_replies.encode_text(*x) for x in scip_replies.decode_texts(reply).items()]
        elif reply.lines:
            lines = scip_replies.encode_scan(scip_replies.decode_scan(reply, SCAN), SCAN.width)
        else:
            lines = []
        made += scip_replies.encode_reply(reply.echo, reply.status, lines)
    assert made == capture[1]


def test_what_the_sensor_said(replies):
    statuses = [(reply.echo, reply.status) for reply in replies]
    assert ("BM", "02") in statuses
    assert ("CR00", "03") in statuses
    states = [scip_replies.decode_texts(reply) for reply in replies if reply.echo == "II"]
    assert [state["TIME"] for state in states] == ["6A5404", "6A55F8"]
    scan = scip_replies.decode_scan(replies[-1], SCAN)
    assert scan.time_ms == 0x6A55FE
    codes = [value for value in scan.values if value < 20]
    assert (codes.count(0), codes.count(7), codes.count(10), len(codes)) == (94, 6, 1, 101)
    assert max(scan.values) == 4166


class Replay:
    """A ``Transport`` that answers as recorded, and streams the recorded scan."""

    def __init__(self, clock, received):
        self.clock, self.requests, self.pending = clock, [], []
        blocks = received.split(b"\n\n")[:-1]
        self.recorded = {block.split(b"\n")[0]: block + b"\n\n" for block in blocks}
        self.scan = blocks[-1].split(b"\n", 3)[3]

    def read(self, timeout):
        self.clock.sleep(timeout)
        due = [data for at, data in self.pending if at <= self.clock.now()]
        self.pending = [item for item in self.pending if item[0] > self.clock.now()]
        return b"".join(due)

    def write(self, data):
        for request in data.split():
            self.requests.append(request)
            self.pending += self.answer(request)

    def answer(self, request):
        now = self.clock.now()
        if request.startswith(b"MD"):
            zero = scip.decode_values(b"JUGn", 4)[0] - int(1000 * now)
            yield now, request + b"\n00P\n\n"
            for turn in range(1, 20):
                stamp = scip_replies.encode_time(zero + int(1000 * now) + 100 * turn)
                at = now + 0.1 * turn + 0.101
                yield at, b"\n".join((request, b"99b", stamp, self.scan, b"", b""))
        else:
            yield now, self.recorded.get(request, request + b"\n00P\n\n")

    def set_baud(self, baud): ...

    def discard_input(self):
        self.pending.clear()

    def close(self): ...


def test_the_driver_reads_the_recorded_sensor(capture, replies):
    clock = VirtualClock()
    wire = Replay(clock, capture[1])
    lidar = UrgLidar(lambda: wire, clock)
    # The driver's own questions are those of the recording, byte by byte.
    assert {b"VV", b"PP", b"II"} <= set(wire.requests) & set(capture[0].split())
    assert lidar.info.version["FIRM"] == "3.1.04(02/Aug./2007)"
    assert lidar.info.version["SERI"] == "H0706400"
    assert lidar.info.parameters["DMAX"] == "5600"
    assert lidar.info.state["STAT"] == "Sensor works well."
    expected = np.array(scip_replies.decode_scan(replies[-1], SCAN).values)
    beyond = expected > 4095
    assert beyond.sum() == 6
    for _ in range(15):
        line = lidar.read_line(1.0)
        assert np.array_equal(values_of(line), np.where(beyond, 0, expected))
        assert (line.codes == VALID).sum() == 682 - 101 - 6
    assert (lidar.stats.good, lidar.stats.bad) == (15, 0)
