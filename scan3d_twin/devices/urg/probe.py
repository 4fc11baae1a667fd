"""Recognising an URG-04LX on a line on which any lidar may be."""

from __future__ import annotations

import re

from scan3d_twin.devices.device import LidarProbe
from scan3d_twin.devices.urg.connect import LIKELY_BAUDS

_ANSWER = re.compile(rb"(QT\n(0[0-9A-F].?|E)\n)|([GM][DS][0-9]{8}[0-9]*\n[0-9]{2}.?\n)")
"""The answer to QT in SCIP 2.0 or 1.1, or a scan that was being sent."""


def recognise_urg(data: bytes) -> str | None:
    """Return ``urg04lx`` if ``data`` is from one."""
    return "urg04lx" if _ANSWER.search(data) else None


PROBE = LidarProbe(
    # The rates of its data sheet; it is on USB as a rule, where they do not matter.
    bauds=LIKELY_BAUDS[:3],
    recognise=recognise_urg,
    # Ends what is in its buffer, then a stream. No other lidar has text commands; VV, which would
    # say more, is reported to mute it if it comes again and again.
    request=b"\nQT\n",
    wait=0.25,
)
"""It answers once per turn of 0.1 s; a scan that was being sent comes first."""
