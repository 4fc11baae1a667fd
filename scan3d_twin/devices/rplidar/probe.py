"""Recognising an RPLIDAR on a line on which any lidar may be."""

from __future__ import annotations

from scan3d_twin.devices.device import LidarProbe
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.rplidar.codec import (
    INFO_LENGTH,
    MAX_REQUEST,
    Command,
    Descriptor,
    DeviceInfo,
    ReplyType,
    decode_info,
    encode_request,
)
from scan3d_twin.devices.rplidar.model import MODELS, STOP_PAUSE

_HEAD = Descriptor(INFO_LENGTH, False, ReplyType.INFO).encode()
_SLOWEST_BAUD = min(model.baud for model in MODELS.values())
_STOP = bytes(MAX_REQUEST) + encode_request(Command.STOP)


def recognise_rplidar(data: bytes) -> str | None:
    """Return the name of the RPLIDAR whose information is in ``data``."""
    info = _find_info(data)
    model = None if info is None else MODELS.get(info.major_id)
    return None if model is None else model.name


def explain_rplidar(data: bytes) -> str | None:
    """Return which RPLIDAR that is not supported sent ``data``; None if none did."""
    info = _find_info(data)
    if info is None or info.major_id in MODELS:
        return None
    known = ", ".join(model.title for model in MODELS.values())
    return f"an RPLIDAR answers, but its model byte {info.model:#x} is that of none of {known}"


def _find_info(data: bytes) -> DeviceInfo | None:
    """Return what an RPLIDAR says about itself in ``data``; None if it is not complete."""
    _, found, rest = data.partition(_HEAD)
    return decode_info(rest[:INFO_LENGTH]) if found and len(rest) >= INFO_LENGTH else None


PROBE = LidarProbe(
    bauds=tuple(model.baud for model in MODELS.values()),
    recognise=recognise_rplidar,
    # Zeros complete any request that was cut off, and begin none; STOP ends a scan. Without a line
    # feed an URG-04LX waits for the rest; an LDROBOT hears nothing.
    stop=_STOP,
    # Their transmission, and ten times what the protocol demands, for the latency of an adapter.
    pause=len(_STOP) * BITS_PER_BYTE / _SLOWEST_BAUD + 10 * STOP_PAUSE,
    request=encode_request(Command.GET_INFO),
    wait=0.12,
    explain=explain_rplidar,
)
"""The scan that was being sent ends within 0.1 s; the answer comes at once."""
