"""Questions to a servo and its answers, by dynamixel-sdk, without blocking.

The packet handler of the SDK makes and checks all packets. It waits by asking its port again and
again whether the time is up; ours says at once that it is, and the answer is tried anew when more
bytes are there. So time passes outside only, in the robot's clock, real or virtual.
Functions that take time are generators that yield where they would block.

What the SDK does with an answer is checked here, since it calls an error or a shortened answer a
success (findings/dynamixel_sdk_replies.sh).
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from scan3d_twin.core.errors import LinkTimeoutError, ProtocolError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.dynamixel.codec import ALERT, BROADCAST, ErrorNumber, Instruction
from scan3d_twin.devices.dynamixel.registers import STATUS_RETURN_LEVEL, Register
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.transport import Transport

T = TypeVar("T")
Steps = Generator[None, None, T]
"""A generator that yields where it would block, and returns a T."""

ATTEMPTS = 10
"""Number of times that a question is asked before giving up: on a line that damages one byte in 33
a third of the questions have a good answer."""
MAX_SLOTS = 0.8
"""Time in which all servos have answered [s]: 3 ms for each of 253 ids, as the SDK allows."""
ALL = 2
"""Status return level at which every instruction is answered."""
_ID, _LENGTH, _ERROR, _DATA = 4, slice(5, 7), 8, 9
"""Places in a status packet."""
_SHORT_STATUS = 11
"""Length of a status packet without data [bytes]."""
_NO_DATA = 4
"""Length field of such a packet."""


class RefusedError(ProtocolError):
    """The servo refuses an instruction.

    Attributes:
        number: Why.
    """

    def __init__(self, what: str, number: int) -> None:
        known = {each.value: each.name.lower() for each in ErrorNumber}
        super().__init__(f"the servo refuses {what}: {known.get(number, 'unknown')} error {number}")
        self.number = number


@dataclass(frozen=True, slots=True)
class Answer:
    """What a servo answered.

    Attributes:
        data: The bytes asked for.
        alert: Whether it has a hardware error.
        sent: Time at which the last byte of the question left, at the earliest [s].
        received: Time at which the answer was there, at the latest [s].
    """

    data: bytes
    alert: bool
    sent: float
    received: float


class SdkPort:
    """A ``PortHandler`` of dynamixel-sdk over a ``Transport``; it never waits.

    Attributes:
        is_using: A flag of the SDK's.
        sent: Time at which the last byte of the last packet left, at the earliest [s].
        deadline: Time until which an answer is waited for [s].
    """

    def __init__(self, transport: Transport, clock: Clock, baud: int) -> None:
        self.is_using = False
        self.sent = self.deadline = 0.0
        self._transport, self._clock, self._baud = transport, clock, baud
        self._buffer, self._at, self._is_fresh = b"", 0, False

    def pump(self, timeout: float = 0.0) -> None:
        """Take in what has arrived, waiting up to ``timeout`` [s] for it.

        Raises:
            LinkError: The servo's line is unplugged.
        """
        data = self._transport.read(timeout)
        self._buffer += data
        self._is_fresh |= bool(data)

    def rewind(self) -> bool:
        """Let the SDK read from the beginning; return whether anything has arrived since."""
        is_fresh, self._is_fresh, self._at = self._is_fresh, False, 0
        return is_fresh

    def forget_read(self) -> None:
        """Drop what the SDK has read; what is left may be another packet."""
        self._buffer, self._at = self._buffer[self._at :], 0
        self._is_fresh = bool(self._buffer)

    def clearPort(self) -> None:  # noqa: N802
        """Drop what has arrived."""
        self._transport.discard_input()
        self._buffer, self._at, self._is_fresh = b"", 0, False

    def readPort(self, length: int) -> list[int]:  # noqa: N802
        """Return up to ``length`` of the bytes that have arrived."""
        data = self._buffer[self._at : self._at + max(0, length)]
        self._at += len(data)
        return list(data)

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802
        """Send ``packet``; return its length."""
        self.sent = self._clock.now() + len(packet) * BITS_PER_BYTE / self._baud
        self._transport.write(bytes(packet))
        return len(packet)

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Wait for an answer of ``packet_length`` bytes, by the SDK's own rule."""
        from dynamixel_sdk.port_handler import LATENCY_TIMER

        transfer = packet_length * BITS_PER_BYTE / self._baud
        self.deadline = self._clock.now() + transfer + (2 * LATENCY_TIMER + 2) / 1000

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Return whether to stop waiting: nothing more comes before time passes."""
        return True


class ServoLink:
    """A line to a servo.

    Attributes:
        clock: The robot's clock.
        baud: Bit rate of the line [bit/s].
        bad: Number of questions without a good answer.
    """

    def __init__(self, transport: Transport, clock: Clock, baud: int) -> None:
        """Use an open line at the bit rate ``baud`` [bit/s].

        Raises:
            LinkError: The port does not support it.
        """
        from dynamixel_sdk import PacketHandler

        transport.set_baud(baud)
        self.clock, self.baud = clock, baud
        self.bad = 0
        self._port = SdkPort(transport, clock, baud)
        self._sdk: Any = PacketHandler(2.0)

    def pump(self, timeout: float) -> None:
        """Let up to ``timeout`` [s] pass until something arrives, where nobody else does so."""
        self._port.pump(timeout)

    def ping(self, servo: int, attempts: int = ATTEMPTS) -> Steps[tuple[int, int]]:
        """Return model number and firmware of the servo with an id.

        Raises:
            LinkTimeoutError: It does not answer.
        """
        answer = yield from self._ask(servo, _plain(servo, Instruction.PING), 3, attempts)
        number, firmware = struct.unpack("<HB", answer.data)
        return number, firmware

    def find_all(self) -> Steps[dict[int, int]]:
        """Return the model numbers of all servos on the line, by id."""
        self._send(_plain(BROADCAST, Instruction.PING))
        self._port.deadline = self.clock.now() + MAX_SLOTS
        found = {}
        while self.clock.now() < self._port.deadline:
            self._port.pump()
            while (packet := self._receive()) is not None:
                if _is_from(packet[_ID], 3, packet):
                    found[packet[_ID]] = int.from_bytes(bytes(packet[_DATA : _DATA + 2]), "little")
            yield
        return found

    def let_answer(self, servo: int) -> Steps[None]:
        """Make the servo answer everything, whatever it was told before.

        It may not answer this very question.
        """
        level = STATUS_RETURN_LEVEL
        params = struct.pack("<H", level.address) + level.encode(ALL)
        self._send(_plain(servo, Instruction.WRITE, params))
        self._port.setPacketTimeout(_SHORT_STATUS)
        yield from self._wait(servo, 0)

    def reboot(self, servo: int) -> Steps[None]:
        """Start the servo anew; it takes a moment."""
        yield from self._ask(servo, _plain(servo, Instruction.REBOOT), 0, ATTEMPTS)

    def read(self, servo: int, start: int, end: int, attempts: int = ATTEMPTS) -> Steps[Answer]:
        """Return the bytes of the control table from address ``start`` up to ``end``.

        Raises:
            RefusedError: The servo refuses.
            LinkTimeoutError: It does not answer.
        """
        length = end - start
        question = _plain(servo, Instruction.READ, struct.pack("<HH", start, length))
        return (yield from self._ask(servo, question, length, attempts))

    def write(self, servo: int, start: Register, *values: int) -> Steps[None]:
        """Write registers that follow each other from ``start`` on, each as long as it.

        Raises:
            RefusedError: The servo refuses.
            LinkTimeoutError: It does not answer.
        """
        data = b"".join(start.encode(value) for value in values)
        params = struct.pack("<H", start.address) + data
        yield from self._ask(servo, _plain(servo, Instruction.WRITE, params), 0, ATTEMPTS)

    def _ask(self, servo: int, question: list[int], length: int, attempts: int) -> Steps[Answer]:
        """Ask until there is a good answer with ``length`` bytes of data."""
        for _ in range(attempts):
            self._send(question)
            self._port.setPacketTimeout(length + _SHORT_STATUS)
            packet = yield from self._wait(servo, length)
            if packet is None:
                self.bad += 1
                continue
            number = packet[_ERROR] & ~ALERT
            if number == ErrorNumber.CRC:
                self.bad += 1
                continue
            if number:
                raise RefusedError(f"instruction {question[7]:#04x}", number)
            data = bytes(packet[_DATA : _DATA + length])
            return Answer(data, bool(packet[_ERROR] & ALERT), self._port.sent, self.clock.now())
        raise LinkTimeoutError(f"the servo {servo} does not answer at {self.baud} baud")

    def _send(self, packet: list[int]) -> None:
        """Send a ``packet``; the SDK fills in header and CRC."""
        # An answer that was not waited for keeps the SDK's port in use
        self._port.is_using = False
        self._sdk.txPacket(self._port, packet.copy())

    def _wait(self, servo: int, length: int) -> Steps[list[int] | None]:
        """Return the status packet of the servo; None if none comes in time."""
        while True:
            self._port.pump()
            while (packet := self._receive()) is not None:
                if _is_from(servo, length, packet):
                    return packet
            if self.clock.now() >= self._port.deadline:
                return None
            yield

    def _receive(self) -> list[int] | None:
        """Return the next good status packet among what has arrived; None if there is none."""
        from dynamixel_sdk import COMM_SUCCESS

        if not self._port.rewind():
            return None
        self._port.is_using = True
        try:
            packet, result = self._sdk.rxPacket(self._port, False)
        except IndexError:
            # The SDK trusts the length field of a packet whose CRC is right by chance
            return None
        if result != COMM_SUCCESS:
            return None
        self._port.forget_read()
        return list(packet)


def _is_from(servo: int, length: int, packet: Sequence[int]) -> bool:
    """Return whether a status packet is of this servo and has ``length`` bytes of data, or none.

    Its length field is the SDK's, which is wrong after it took data for stuffing.
    """
    if packet[_ID] != servo or len(packet) < _SHORT_STATUS:
        return False
    stated = int.from_bytes(bytes(packet[_LENGTH]), "little")
    if packet[_ERROR] & ~ALERT:
        return stated == _NO_DATA
    return stated == _NO_DATA + length


def _plain(servo: int, instruction: int, params: bytes = b"") -> list[int]:
    """Return a packet with room for its header and its CRC.

    The SDK does not stuff it (findings/dynamixel_sdk_stuffing.sh), but nothing that is written here
    needs it: neither a position nor a speed holds FF FF FD.
    """
    head = struct.pack("<BHB", servo, 1 + len(params) + 2, instruction)
    return [0, 0, 0, 0, *head, *params, 0, 0]
