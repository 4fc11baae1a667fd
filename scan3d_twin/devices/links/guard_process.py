"""The guard process: stops the wheels when the driving process no longer can.

It is run as a file by a bare interpreter (``python -I -S``) and imports only a small part of the
standard library, so that it is ready within about 20 ms. It inherits the descriptor of the port and
reads heartbeats from a pipe; the only clock it uses is the time-out of ``poll``.

    guard_process.py PORT_FD PIPE_FD FAREWELL_HEX SILENCE_MS
"""

from __future__ import annotations

import os
import select
import sys

MOVING, STANDING, GOODBYE = b"m", b"s", b"q"


def guard(port: int, pipe: int, farewell: bytes, silence_ms: int) -> None:
    """Send ``farewell`` if the pipe ends without a goodbye, or is silent while moving."""
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    moving = False
    while True:
        # Stop the wheels after a silence
        if not poll.poll(silence_ms if moving else None):
            moving = False
            send(port, farewell)
            continue

        # Follow the heartbeats
        word = os.read(pipe, 4096)
        if not word:
            send(port, farewell)
        if not word or word.endswith(GOODBYE):
            return
        moving = word.endswith(MOVING)


def send(port: int, data: bytes) -> None:
    """Write ``data`` to a port that may block or be gone."""
    poll = select.poll()
    poll.register(port, select.POLLOUT)
    try:
        while data and poll.poll(1000):
            data = data[os.write(port, data) :]
    except OSError:
        return


if __name__ == "__main__":
    guard(int(sys.argv[1]), int(sys.argv[2]), bytes.fromhex(sys.argv[3]), int(sys.argv[4]))
