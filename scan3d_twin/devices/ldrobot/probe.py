"""Recognising the LDROBOT lidars by listening: they send by themselves and take no commands."""

from __future__ import annotations

from scan3d_twin.devices.device import LidarProbe
from scan3d_twin.devices.ldrobot.codec import FOREIGN, READINGS, Splitter
from scan3d_twin.devices.ldrobot.model import MODELS

MIN_PACKETS = 3
"""Good packets that are no chance: a CRC-8 fits one in 256."""


def recognise_ld(data: bytes) -> str | None:
    """Return the name of the lidar that sent ``data``, by the rate of its readings.

    An LD06 cannot be told from an LD19, whose numbers are the same: it is called ``ld19``.
    """
    packets = Splitter().feed(data)
    if len(packets) < MIN_PACKETS:
        return None
    rates = sorted(100 * p.speed * (READINGS - 1) / max(1, p.span) for p in packets)
    rate = rates[len(rates) // 2]
    nearest = min(MODELS, key=lambda model: abs(rate / model.sample_rate - 1))
    return nearest.name.lower()


def explain_ld(data: bytes) -> str | None:
    """Return that ``data`` is in the protocol of a lidar that is sold as an LD19, if it is."""
    splitter = Splitter()
    splitter.feed(data)
    return f"bytes arrive, but {FOREIGN}" if splitter.is_foreign else None


PROBE = LidarProbe(
    bauds=tuple(model.baud for model in MODELS),
    recognise=recognise_ld,
    wait=0.1,
    explain=explain_ld,
)
"""In a tenth of a second an LD19 sends 37 packets."""
