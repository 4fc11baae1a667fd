"""Recognising an RPLIDAR on a line on which any lidar may be."""

from __future__ import annotations

from scan3d_twin.devices.device import LidarProbe
from scan3d_twin.devices.rplidar.codec import (
    INFO_LENGTH,
    Command,
    Descriptor,
    ReplyType,
    decode_info,
    encode_request,
)
from scan3d_twin.devices.rplidar.model import A1, C1, MODELS, S2, STOP_PAUSE

_HEAD = Descriptor(INFO_LENGTH, False, ReplyType.INFO).encode()


def recognise_rplidar(data: bytes) -> str | None:
    """Return the name of the RPLIDAR whose information is in ``data``."""
    _, found, rest = data.partition(_HEAD)
    if not found or len(rest) < INFO_LENGTH:
        return None
    model = MODELS.get(decode_info(rest[:INFO_LENGTH]).major_id)
    return None if model is None else model.name


PROBE = LidarProbe(
    bauds=(C1.baud, A1.baud, S2.baud),
    recognise=recognise_rplidar,
    # STOP ends a scan, several complete a request that was cut off. Two binary bytes without a line
    # feed: an URG-04LX waits for the rest, an LDROBOT hears nothing.
    stop=4 * encode_request(Command.STOP),
    # Ten times what the protocol demands, for the latency of an adapter.
    pause=10 * STOP_PAUSE,
    request=encode_request(Command.GET_INFO),
    wait=0.12,
)
"""The scan that was being sent ends within 0.1 s; the answer comes at once."""
