"""An emulated XL330 on a half-duplex line: moves a ``Turntable`` as the instructions ask."""

from __future__ import annotations

from collections import deque

from scan3d_twin.core.hal import Turntable
from scan3d_twin.devices.dynamixel.codec import DamagedPacket, PacketSplitter
from scan3d_twin.devices.dynamixel.emulated_firmware import ServoFirmware, ServoProfile
from scan3d_twin.devices.dynamixel.emulated_motor import Motor

MAX_PAUSE = 0.02
"""Pause inside a packet after which the rest is not waited for [s]; assumption."""


class Xl330Emulator:
    """A ``Device``: an XL330 that turns ``turntable``.

    Attributes:
        firmware: The state of the servo.
        baud: See ``Device.baud``.
        began: See ``Device``.
    """

    def __init__(self, turntable: Turntable, profile: ServoProfile | None = None) -> None:
        profile = ServoProfile() if profile is None else profile
        self.firmware = ServoFirmware(Motor(turntable), profile)
        self.baud = profile.baud
        self.began = 0.0
        self._splitter = PacketSplitter()
        self._out: deque[tuple[float, bytes]] = deque()
        self._heard = 0.0

    def receive(self, data: bytes, now: float) -> None:
        """See ``Device.receive``."""
        if self.firmware.profile.echo:
            self._out.append((now, data))
        if now < self.firmware.deaf_until:
            return
        if now - self._heard > MAX_PAUSE:
            self._splitter.clear()
        self._heard = now
        for packet in self._splitter.feed(data):
            # A new return delay counts from the next reply on
            ready = now + self.firmware.return_delay
            if isinstance(packet, DamagedPacket):
                replies = self.firmware.answer_damaged(packet.id)
            else:
                replies = self.firmware.answer(packet, now)
            self._out += [(ready + reply.wait, reply.data) for reply in replies]

    def transmit(self, now: float) -> bytes:
        """See ``Device.transmit``."""
        self.firmware.watch(now)
        if not self._out or self._out[0][0] > now + 1e-9:
            # The reply to a new bit rate is sent at the old one
            if not self._out:
                self.baud = self.firmware.baud
            return b""
        self.began, data = self._out.popleft()
        return data
