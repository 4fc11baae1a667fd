"""A run that another program steers: pause, continue, stop and leave on standard input."""

import io
import os
import signal
import subprocess
import sys
import time

import pytest

from scan3d_twin.cli.remote import RemoteCommands

SOON = 10.0
"""Patience with a busy computer [s]."""


class NotingView:
    """A live view that notes what it was told."""

    def __init__(self):
        self.told = []

    def set_pause(self, wanted):
        self.told.append("pause" if wanted else "continue")

    def leave(self):
        self.told.append("leave")


@pytest.fixture
def interrupts():
    """The interrupts that the main thread received."""
    received = []
    before = signal.signal(signal.SIGINT, lambda *_: received.append("interrupt"))
    yield received
    signal.signal(signal.SIGINT, before)


def until(condition):
    """Wait until ``condition`` is true."""
    end = time.monotonic() + SOON
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def commanded(interrupts):
    """Commands of a pipe, the end that is written, and a view that they steer."""
    reading, writing = os.pipe()
    with open(reading) as stream, open(writing, "w", buffering=1) as sender:
        view = NotingView()
        commands = RemoteCommands(stream)
        commands.attach(view)
        yield view, sender
        sender.close()
        commands.join()


def test_lines_pause_continue_and_stop(commanded, interrupts, capfd):
    view, sender = commanded
    sender.write("pause\ncontinue\n\njump\n")
    until(lambda: view.told == ["pause", "continue"])
    assert interrupts == []
    sender.write("stop\nleave\n")
    until(lambda: view.told[2:] == ["leave"])
    assert interrupts == ["interrupt"]
    words = capfd.readouterr().err
    assert words == "unknown command 'jump'; known: pause, continue, stop, leave\n"


def test_a_run_is_interrupted_once_so_that_it_can_save(commanded, interrupts):
    view, sender = commanded
    sender.write("stop\nstop\n")
    sender.close()
    until(lambda: view.told == ["leave"])
    assert interrupts == ["interrupt"]


def test_the_end_of_the_input_is_a_stop(interrupts):
    commands = RemoteCommands(io.StringIO(""))
    until(lambda: interrupts == ["interrupt"])
    view = NotingView()
    commands.attach(view)
    assert view.told == ["leave"]


def test_a_pause_before_there_is_a_view_is_kept(interrupts):
    commands = RemoteCommands(io.StringIO("pause\n"))
    commands.join()
    view = NotingView()
    commands.attach(view)
    assert view.told == ["pause", "leave"]


def test_commands_take_a_live_view(fails):
    assert "--commands goes with --view" in fails(2, "sim", "--commands")


def test_a_run_without_an_input_is_not_commanded():
    command = ["sh", "-c", '"$0" -m scan3d_twin.cli sim --view --commands <&-', sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == "error: --commands reads standard input, which is closed\n"
