"""What the program prints, and what happens when its reader is gone (``twin planners | head``)."""

from __future__ import annotations

import errno
import os
import re
import sys
from typing import IO

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters other than tab and line feed, with which a text would steer the terminal, and
surrogates, which stand for bytes of a file's name that are not UTF-8."""


def printable(text: str) -> str:
    """Return ``text``, which may come from a file, without characters that steer a terminal."""
    return _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)


def say(text: str, stream: IO[str] | None = None, end: str = "\n") -> None:
    """Print ``text`` at once, by default on standard error.

    For what is said during a run, which goes on whether anybody reads or not: a reader that is gone
    is no error, nor is a terminal that was closed.
    """
    stream = sys.stderr if stream is None else stream
    try:
        print(printable(text), file=stream, end=end, flush=True)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        discard(stream)


def discard(stream: IO[str]) -> None:
    """Send what is written to ``stream`` from now on, and what it still holds, nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
