"""A model of the receiving half of a UART that may listen at another rate than the talker's.

The receiver samples the waveform of the talker (start bit, eight data bits, stop bit; the lowest
bit first; idle is high) as a UART does, so that a wrong bit rate yields the bytes that a real line
yields: always the same ones, up to where a sample falls on the edge of a bit.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.devices.links.line_format import BITS_PER_BYTE

OVERSAMPLING = 16
"""Ticks per bit in which a receiver looks for the edge of a start bit; ATmega and STM32 manuals."""
CLOCK_ERROR = 0.01
"""Largest difference between the clocks of talker and listener, as a share; assumption: half of the
2 % that the manual of the ATmega recommends as the largest error of a receiver."""


class Uart:
    """A receiver: it takes in what the talker sends, and returns the characters it reads.

    * A start bit begins at a falling edge and must still be low at its middle.
    * A character with a low stop bit is a character like any other; a Linux terminal without INPCK
      and small microcontrollers that ignore the error flag read it so. The next start bit is then
      looked for once the line is high again.
    """

    def __init__(self, seed: int) -> None:
        """Draw the difference of the clocks and the delay of each sample from ``seed``."""
        rng = np.random.default_rng([seed, BITS_PER_BYTE])
        self._clock = 1.0 + rng.uniform(-CLOCK_ERROR, CLOCK_ERROR)
        self._middle = 0.5 + rng.uniform(0.0, 1.0 / OVERSAMPLING)
        self._levels, self._end = b"", 0.0
        self._sent = self._heard = 0
        self._samples: list[int] = []

    def take(self, data: bytes, start: float, sent: int, heard: int) -> bytes:
        """Return the characters read of ``data``; an unfinished one is kept.

        Args:
            data: Bytes of the talker.
            start: Time at which the first one starts [s].
            sent: Bit rate of the talker [bit/s].
            heard: Bit rate of the receiver [bit/s].
        """
        # Finish what was sent or heard at another rate, or long before
        done = b""
        if (sent, heard) != (self._sent, self._heard):
            done = self._finish()
            self._sent, self._heard = sent, heard
            step = self._clock * sent / heard
            self._samples = [int((bit + self._middle) * step) for bit in range(BITS_PER_BYTE)]
        done += self.idle(start)

        # Put the new bits behind the unfinished character
        idle = max(0, round((start - self._end) * sent)) if self._levels else 0
        self._levels += bytes([1]) * idle + _waveform(data)
        self._end = start + len(data) * BITS_PER_BYTE / sent
        return done + self._read()

    def idle(self, now: float) -> bytes:
        """Return the unfinished character if the line has been idle up to ``now`` [s] for long."""
        is_over = self._levels and now - self._end > BITS_PER_BYTE / self._heard
        return self._finish() if is_over else b""

    def _finish(self) -> bytes:
        """Return the unfinished character: an idle line is high."""
        if not self._levels:
            return b""
        self._levels += bytes([1]) * (self._samples[-1] + 1)
        done = self._read()
        self._levels = b""
        return done

    def _read(self) -> bytes:
        """Return the complete characters; leave the bits from an unfinished one on."""
        levels, done, edge = self._levels, bytearray(), self._levels.find(0)
        while edge >= 0 and edge + self._samples[-1] < len(levels):
            # Take a character, unless its start bit is too short for one
            first, *bits, _ = (levels[edge + place] for place in self._samples)
            at = edge + 1
            if not first:
                done.append(sum(bit << place for place, bit in enumerate(bits)))
                at = edge + self._samples[-1]

            # Find the next falling edge
            edge = levels.find(0, max(at, levels.find(1, at)))
        self._levels = levels[edge:] if edge >= 0 else b""
        return bytes(done)


def _waveform(data: bytes) -> bytes:
    """Return the levels of the line, 0 or 1, one for each bit."""
    levels = np.empty((len(data), BITS_PER_BYTE), np.uint8)
    levels[:, 0], levels[:, -1] = 0, 1
    values = np.frombuffer(data, np.uint8)
    levels[:, 1:-1] = np.unpackbits(values[:, None], axis=1, bitorder="little")
    return levels.tobytes()
