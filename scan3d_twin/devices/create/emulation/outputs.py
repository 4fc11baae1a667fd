"""The outputs of an emulated Create: LEDs, digits, drivers, infrared and songs."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Outputs:
    """What the base shows, plays and switches.

    Fields of bytes are the data last commanded; None is off.

    Attributes:
        song: Number of the song that plays, or was the last to play.
        song_ends: When it ends [s].
    """

    leds: bytes | None = None
    drivers: bytes | None = None
    pwm: bytes | None = None
    digital: bytes | None = None
    digits: bytes | None = None
    songs: dict[int, bytes] = field(default_factory=dict)
    sent_ir: bytes | None = None
    buttons: bytes | None = None
    song: int = 0
    song_ends: float = 0.0

    def store_song(self, data: bytes, most: int) -> None:
        """Store the song of the command with ``data``, if its number is below ``most``."""
        number, length = data[:2]
        if number < most and 1 <= length <= 16:
            self.songs[number] = data[2:]

    def play_song(self, number: int, now: float) -> None:
        """Play a song from ``now`` [s] on, if it is stored and no other one plays."""
        notes = self.songs.get(number)
        if notes and now >= self.song_ends:
            self.song = number
            self.song_ends = now + sum(notes[1::2]) / 64
