"""Play and Pause, pressed in other threads than the one that moves the slider."""

import threading
from types import SimpleNamespace

import pytest

from scan3d_twin.viz.served import player
from scan3d_twin.viz.served.player import Player


class Slider:
    """A slider that counts who moves it, and says when it did."""

    def __init__(self):
        self.min, self.max, self._value = 0.0, 1e9, 0.0
        self.movers, self.moved = [], threading.Event()

    @property
    def value(self):
        return self._value

    @value.setter
    def value(self, new):
        self._value = new
        self.movers.append(threading.current_thread())
        self.moved.set()


class Gui:
    """Gives buttons and a choice without a server."""

    def add_button(self, *_, visible=True, **__):
        return SimpleNamespace(visible=visible, on_click=lambda _: None)

    def add_dropdown(self, *_, initial_value):
        return SimpleNamespace(value=initial_value)


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(player, "TICK", 0.01)
    slider = Slider()
    play = Player(Gui(), slider)
    yield play, slider
    play.pause()


def wait_until_moved(slider):
    slider.moved.clear()
    assert slider.moved.wait(5.0)


def test_pausing_and_playing_at_once_leaves_one_that_moves(made):
    play, slider = made
    for _ in range(20):
        play.play()
        play.pause()
    play.play()
    wait_until_moved(slider)
    slider.movers.clear()
    for _ in range(5):
        wait_until_moved(slider)
    assert len(set(slider.movers)) == 1
    assert (play._play.visible, play._pause.visible) == (False, True)


def test_the_slider_stands_still_once_paused(made):
    play, slider = made
    play.play()
    wait_until_moved(slider)
    (mover,) = set(slider.movers)
    play.pause()
    stopped = slider.value
    mover.join(5.0)
    assert not mover.is_alive()
    assert slider.value == stopped
    assert (play._play.visible, play._pause.visible) == (True, False)


def test_it_stops_at_the_end_and_begins_again_from_there(made):
    play, slider = made
    slider.max = 0.05
    play.play()
    wait_until_moved(slider)
    (mover,) = set(slider.movers)
    mover.join(5.0)
    assert slider.value == slider.max
    assert play._play.visible
    slider.max = 1e9
    slider._value = slider.max
    play.play()
    wait_until_moved(slider)
    assert slider.value < slider.max
