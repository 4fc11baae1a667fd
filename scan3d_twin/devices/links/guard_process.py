"""The guard's own process: stops the wheels when the process that drives can no longer.

Run as a file by a bare interpreter (``python -I -S``), so it imports nothing but the smallest part
of the standard library and is ready within some 20 ms. It holds the port as an inherited descriptor
and reads signs of life from a pipe; time is only what ``poll`` waits.

    guard_process.py PORT_FD PIPE_FD FAREWELL_HEX SILENCE_MS
"""

from __future__ import annotations

import os
import select
import sys

MOVING, STANDING, GOODBYE = b"m", b"s", b"q"


def guard(port: int, pipe: int, farewell: bytes, silence_ms: int) -> None:
    """Send ``farewell`` when the pipe ends without a goodbye, or is silent while moving."""
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    moving = False
    while True:
        if not poll.poll(silence_ms if moving else None):
            moving = False
            send(port, farewell)
            continue
        word = os.read(pipe, 4096)
        if not word:
            send(port, farewell)
        if not word or word.endswith(GOODBYE):
            return
        moving = word.endswith(MOVING)


def send(port: int, data: bytes) -> None:
    """Write ``data`` to a port that may not take it at once, or be gone."""
    poll = select.poll()
    poll.register(port, select.POLLOUT)
    try:
        while data and poll.poll(1000):
            data = data[os.write(port, data) :]
    except OSError:
        return


if __name__ == "__main__":
    guard(int(sys.argv[1]), int(sys.argv[2]), bytes.fromhex(sys.argv[3]), int(sys.argv[4]))
