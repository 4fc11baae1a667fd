"""An emulated RPLIDAR: serves any ``Lidar`` as bytes, with the pace of the real sensor."""

from __future__ import annotations

import math
from collections import deque

from scan3d_twin.core.hal import Lidar
from scan3d_twin.core.types import VALID, Beams
from scan3d_twin.devices.rotating import BeamReader
from scan3d_twin.devices.rplidar import capsules
from scan3d_twin.devices.rplidar.capsules import Capsule
from scan3d_twin.devices.rplidar.codec import ReplyType, Request, RequestSplitter
from scan3d_twin.devices.rplidar.emulated_firmware import Firmware, RplidarProfile
from scan3d_twin.devices.rplidar.model import SAMPLES, Motor, RplidarModel, ScanMode
from scan3d_twin.devices.rplidar.nodes import DISTANCE_UNITS, MAX_DISTANCE, Node

REQUEST_TIME = 5.0
"""Time in which all bytes of a request must arrive, else it is discarded [s]; the protocol."""
REPLY_TIME = 0.001
"""Time from a request to its reply [s]; assumption, the wait after STOP that the protocol asks."""
QUALITY = 47
"""Quality of a sample with a distance; the one that the SDK gives to all of a capsule."""
CORRECTION = 58
"""Angle correction of an express sample [1/8 deg], 7.25 deg: that of an A1 at 1.9 m by the SDK's
formula. A real one depends on the distance, and its beams are as irregular."""

MAX_EARLY = 1e-5
"""Time by which a sample may be taken before it is due [s]: a third of the period of an S2."""

Sample = tuple[float, float, int]
"""Time [s], angle clockwise [1/64 deg], distance [mm] or 0."""


class RplidarEmulator:
    """A ``Device``: an RPLIDAR that measures what ``lidar`` measures.

    Attributes:
        firmware: The state of the lidar.
        began: See ``Device``.
    """

    def __init__(
        self, lidar: Lidar, model: RplidarModel, profile: RplidarProfile | None = None
    ) -> None:
        self.firmware = Firmware(model, RplidarProfile() if profile is None else profile)
        self.began = 0.0
        self._beams = BeamReader(lidar)
        self._requests, self._begun = RequestSplitter(), 0.0
        self._out: deque[tuple[float, bytes]] = deque()
        self._samples: list[Sample] = []
        self._is_first = True
        self._last_angle = 0.0
        self._due = 0.0

    @property
    def baud(self) -> int:
        """See ``Device.baud``."""
        return self.firmware.model.baud

    def set_dtr(self, on: bool, now: float) -> None:
        """Set the line DTR; of an A1 it stops the motor."""
        if self.firmware.model.motor is Motor.DTR:
            self._measure()
            self.firmware.set_motor(not on, now)
            self._samples, self._is_first = [], True

    def receive(self, data: bytes, now: float) -> None:
        """See ``Device.receive``."""
        self._measure()
        if now < self.firmware.deaf_until:
            return
        for request in self._take_requests(data, now):
            before = self.firmware.mode, self.firmware.scan_from
            reply = self.firmware.answer(request, now)
            if (self.firmware.mode, self.firmware.scan_from) != before:
                self._samples, self._is_first = [], True
            if reply:
                ready = max(now + REPLY_TIME, self.firmware.deaf_until)
                self._out.append((ready, reply))

    def _take_requests(self, data: bytes, now: float) -> list[Request]:
        """Return the requests that ``data`` completes at ``now`` [s]."""
        if now > self._begun + REQUEST_TIME:
            self._requests.reset()
        is_new = not self._requests.is_waiting
        requests = self._requests.feed(data)
        if is_new or requests:
            self._begun = now
        return requests

    def transmit(self, now: float) -> bytes:
        """See ``Device.transmit``."""
        self._measure()
        if not self._out or self._out[0][0] > now:
            return b""
        self.began, data = self._out.popleft()
        return data

    def _measure(self) -> None:
        """Take in the samples measured since the last call; send the frames they complete."""
        beams = self._beams.read()
        mode = self.firmware.mode
        if mode is None or not len(beams):
            return
        beams = beams.select(beams.times >= self.firmware.scan_from)
        self._samples += self._thin_out(to_samples(beams), mode.sample_us * 1e-6)
        size = SAMPLES[mode.reply]
        while len(self._samples) > size:
            chunk, self._samples = self._samples[:size], self._samples[size:]
            self._out.append((chunk[-1][0], self._encode(mode, chunk)))
            self._is_first = False

    def _thin_out(self, samples: list[Sample], period: float) -> list[Sample]:
        """Return the ``samples`` that a mode with a longer ``period`` [s] takes."""
        taken = []
        for sample in samples:
            if sample[0] >= self._due - MAX_EARLY:
                taken.append(sample)
                self._due = max(self._due + period, sample[0] + period / 2)
        return taken

    def _encode(self, mode: ScanMode, chunk: list[Sample]) -> bytes:
        """Return the frame of the samples of ``chunk``."""
        start = round(chunk[0][1])
        if mode.reply is ReplyType.NODES:
            is_first = self._is_first or chunk[0][1] < self._last_angle
            self._last_angle = chunk[0][1]
            return encode_node(start, chunk[0][2], is_first)

        # The encoder is ahead of the beam by the correction
        distances = tuple(mm for _, _, mm in chunk)
        if mode.reply is ReplyType.DENSE:
            distances = tuple(min(mm, capsules.MAX_DENSE_MM) for mm in distances)
            capsule = Capsule(start % capsules.TURN_UNITS, distances, (), self._is_first)
            return capsules.encode_dense(capsule)
        distances = tuple(min(mm, capsules.MAX_EXPRESS_MM) for mm in distances)
        start = (start + CORRECTION * capsules.CORRECTION_STEP) % capsules.TURN_UNITS
        corrections = (CORRECTION,) * len(distances)
        return capsules.encode_express(Capsule(start, distances, corrections, self._is_first))


def to_samples(beams: Beams) -> list[Sample]:
    """Return ``beams`` as the lidar counts them: clockwise angles, millimetres, 0 for no return."""
    units = capsules.TURN_UNITS / math.tau
    angles = (beams.elevations % math.tau * units).tolist()
    mm = [
        round(1000 * distance) if code == VALID else 0
        for distance, code in zip(beams.ranges.tolist(), beams.codes.tolist(), strict=True)
    ]
    return list(zip(beams.times.tolist(), angles, mm, strict=True))


def encode_node(angle: int, mm: int, is_first: bool) -> bytes:
    """Return a standard node at ``angle`` [1/64 deg] with a distance of ``mm``, or 0."""
    distance = min(mm * DISTANCE_UNITS, MAX_DISTANCE)
    node = Node(angle % capsules.TURN_UNITS, distance, QUALITY if mm else 0, is_first)
    return node.encode()
