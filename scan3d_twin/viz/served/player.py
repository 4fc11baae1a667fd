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
    """A Play and a Pause button that move ``slider``, in seconds, until its end.

    The buttons are pressed in threads of the server, and each Play starts a thread of its own that
    moves the slider: one at a time, until the event that Pause sets.
    """

    def __init__(self, gui: Any, slider: Any) -> None:
        self._slider = slider
        self._lock = threading.RLock()
        self._stopped: threading.Event | None = None
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, color="green")
        self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, visible=False)
        self._speed = gui.add_dropdown("Speed", tuple(PLAY_SPEEDS), initial_value="10x")
        self._play.on_click(lambda _: self.play())
        self._pause.on_click(lambda _: self.pause())

    def play(self) -> None:
        """Begin to move, from the beginning if the slider is at its end."""
        with self._lock:
            if self._stopped is not None:
                return
            self._stopped = threading.Event()
            self._play.visible, self._pause.visible = False, True
            if self._slider.value >= self._slider.max:
                self._slider.value = self._slider.min
            threading.Thread(target=self._move, args=(self._stopped,), daemon=True).start()

    def pause(self) -> None:
        """Stop moving; the slider stands still when this returns."""
        with self._lock:
            if self._stopped is not None:
                self._stopped.set()
            self._stopped = None
            self._play.visible, self._pause.visible = True, False

    def _move(self, stopped: threading.Event) -> None:
        """Move the slider until the end, or until ``stopped``."""
        before = time.monotonic()
        while not stopped.wait(TICK):
            with self._lock:
                if stopped.is_set():
                    return
                now = time.monotonic()
                step, before = PLAY_SPEEDS[self._speed.value] * (now - before), now
                self._slider.value = min(self._slider.max, self._slider.value + step)
                if self._slider.value >= self._slider.max:
                    self.pause()
