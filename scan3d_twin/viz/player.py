"""Playing a recorded run: a slider that moves by itself."""

from __future__ import annotations

import threading
import time
from typing import Any

import viser

TICK = 0.1
"""Time between two steps of the slider [s]."""
PLAY_SPEEDS = {"real time": 1.0, "5x": 5.0, "10x": 10.0, "30x": 30.0, "100x": 100.0}
"""Speeds by name."""


class Player:
    """A Play and a Pause button that move ``slider``, in seconds, until its end."""

    def __init__(self, gui: Any, slider: Any) -> None:
        self._slider = slider
        self._lock = threading.Lock()
        self._playing = threading.Event()
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, color="green")
        self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, visible=False)
        self._speed = gui.add_dropdown("Speed", tuple(PLAY_SPEEDS), initial_value="10x")
        self._play.on_click(lambda _: self.play())
        self._pause.on_click(lambda _: self.pause())

    def play(self) -> None:
        """Begin to move, from the beginning if the slider is at its end."""
        with self._lock:
            if self._playing.is_set():
                return
            self._playing.set()
        self._play.visible, self._pause.visible = False, True
        if self._slider.value >= self._slider.max:
            self._slider.value = self._slider.min
        threading.Thread(target=self._move, daemon=True).start()

    def pause(self) -> None:
        """Stop moving."""
        with self._lock:
            self._playing.clear()
        self._play.visible, self._pause.visible = True, False

    def _move(self) -> None:
        """Move the slider until the end, or until ``pause``."""
        before = time.monotonic()
        while self._playing.is_set():
            time.sleep(TICK)
            now = time.monotonic()
            step, before = PLAY_SPEEDS[self._speed.value] * (now - before), now
            place = min(self._slider.max, self._slider.value + step)
            if self._playing.is_set():
                self._slider.value = place
            if place >= self._slider.max:
                self.pause()
