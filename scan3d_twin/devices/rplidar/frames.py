"""Finding the frames of a scan in a stream of bytes, of which some are damaged, lost or added.

Frames have no header that could not occur in their data, so a frame is believed when it fits what
follows it. Only what is damaged is dropped: nothing else waits for it or is lost with it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from scan3d_twin.devices.rplidar.capsules import CAPSULE_LENGTH, is_intact, is_synced
from scan3d_twin.devices.rplidar.nodes import (
    ANGLE_UNITS,
    NODE_LENGTH,
    TURN_UNITS,
    angle_at,
    is_node,
)

SYNC_LENGTH = 2
"""Bytes of a capsule that hold its sync nibbles."""
CAPSULE_WINDOW = 2 * CAPSULE_LENGTH + SYNC_LENGTH
"""Bytes in which a capsule is weighed against the one after it."""
CHAIN = 4
"""Nodes in a row that fit each other before the first is believed, where the stream was damaged:
random bytes pass in 1 of 4**4 * 16**3 cases."""
MAX_NODE_STEP, MAX_NODE_RETREAT = 12 * ANGLE_UNITS, 10 * ANGLE_UNITS
"""Largest turn from one node to the next, onwards and back [1/64 deg]. An A1 turns by 1.35 deg from
node to node at 7.4 turns per second; its optics shift a node by its distance, by 9.1 deg from
0.15 m to 12 m (the SDK's formula for ultra capsules)."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame of a scan.

    Attributes:
        data: Its bytes.
        arrival: Time by which its last byte had arrived [s].
        skipped: Bytes left out before it since the last frame.
    """

    data: bytes
    arrival: float
    skipped: int


class _Splitter:
    """A buffer of bytes with their times of arrival.

    Attributes:
        bad: Number of frames dropped.
    """

    length: int

    def __init__(self) -> None:
        self.bad = 0
        self._buffer = bytearray()
        self._taken = 0
        self._skipped = 0
        self._is_rest = False
        self._marks: deque[tuple[int, float]] = deque()

    def restart(self) -> None:
        """Forget the frame that has begun, after bytes were discarded; its rest is no damage."""
        self._taken += len(self._buffer)
        self._buffer.clear()
        self._marks.clear()
        self._skipped, self._is_rest = 0, True

    def feed(self, data: bytes, now: float) -> list[Frame]:
        """Return the frames that are certain once ``data`` has arrived at ``now`` [s]."""
        self._buffer += data
        if data:
            self._marks.append((self._taken + len(self._buffer), now))
        return list(self._frames())

    def _frames(self) -> Iterator[Frame]:
        raise NotImplementedError

    def _accept(self) -> Frame:
        """Return the frame at the start of the buffer and remove it."""
        if self._skipped and not self._is_rest:
            self.bad += max(1, round(self._skipped / self.length))
        end = self._taken + self.length
        while self._marks[0][0] < end:
            self._marks.popleft()
        frame = Frame(bytes(self._buffer[: self.length]), self._marks[0][1], self._skipped)
        self._remove(self.length)
        self._skipped, self._is_rest = 0, False
        return frame

    def _skip(self, count: int = 1) -> None:
        self._skipped += count
        self._remove(count)

    def _remove(self, count: int) -> None:
        del self._buffer[:count]
        self._taken += count


class CapsuleSplitter(_Splitter):
    """Finds capsules.

    A capsule whose checksum fits is believed if another begins where it ends. If none does, either
    the next one is damaged, or this one has lost or gained a byte and fits by chance (1 in 256):
    then the next intact capsule begins before its end, or one byte after it.
    """

    length = CAPSULE_LENGTH

    def _frames(self) -> Iterator[Frame]:
        while len(self._buffer) >= CAPSULE_LENGTH + SYNC_LENGTH:
            if not is_intact(self._buffer, 0):
                self._skip()
            elif is_synced(self._buffer, CAPSULE_LENGTH):
                yield self._accept()
            elif len(self._buffer) < CAPSULE_WINDOW:
                return
            elif doubt := self._find_contradiction():
                self._skip(doubt)
            else:
                yield self._accept()

    def _find_contradiction(self) -> int:
        """Return where an intact capsule begins that rules out the one at the start; 0 if none."""
        beginnings = (*range(1, CAPSULE_LENGTH), CAPSULE_LENGTH + 1)
        return next((at for at in beginnings if is_intact(self._buffer, at)), 0)


class NodeSplitter(_Splitter):
    """Finds standard nodes: those that continue the turn, and are followed by one that does."""

    length = NODE_LENGTH

    def __init__(self) -> None:
        super().__init__()
        self._last: int | None = None

    def restart(self) -> None:
        """See ``_Splitter.restart``."""
        super().restart()
        self._last = None

    def _frames(self) -> Iterator[Frame]:
        window = (CHAIN + 2) * NODE_LENGTH + 1
        while len(self._buffer) >= window:
            if self._is_believed():
                self._last = angle_at(self._buffer, 0)
                yield self._accept()
            elif self._is_chain(NODE_LENGTH):
                self._skip(NODE_LENGTH)
            else:
                self._skip()
                self._last = None

    def _is_believed(self) -> bool:
        if self._last is None:
            return self._is_chain(0)
        if not is_node(self._buffer, 0):
            return False
        # A damaged node may lie between this one and the last, or between this one and the next
        steps = 1 + self._skipped // NODE_LENGTH
        if not _continues(self._last, angle_at(self._buffer, 0), steps):
            return False
        return self._follows(0, NODE_LENGTH) or self._is_next_damaged()

    def _is_next_damaged(self) -> bool:
        """Return whether the next node is damaged, in place or by a byte lost or added.

        If the node at the start has itself lost or gained a byte, the next begins a byte off.
        """
        if any(self._is_chain(NODE_LENGTH + off) for off in (-1, 1)):
            return False
        return any(self._is_chain(2 * NODE_LENGTH + off) for off in (0, -1, 1))

    def _is_chain(self, at: int) -> bool:
        """Return whether ``CHAIN`` nodes follow each other from ``at`` on."""
        pairs = range(at, at + (CHAIN - 1) * NODE_LENGTH, NODE_LENGTH)
        return all(self._follows(each, each + NODE_LENGTH) for each in pairs)

    def _follows(self, at: int, following: int) -> bool:
        """Return whether the node at ``following`` continues the turn of that at ``at``."""
        data = self._buffer
        if not (is_node(data, at) and is_node(data, following)):
            return False
        return _continues(angle_at(data, at), angle_at(data, following))


def _continues(angle: int, following: int, steps: int = 1) -> bool:
    """Return whether the lidar can have turned on from one angle to another [1/64 deg]."""
    turned = (following - angle + MAX_NODE_RETREAT) % TURN_UNITS - MAX_NODE_RETREAT
    return turned <= steps * MAX_NODE_STEP
