"""Description of the URG-04LX for the device registry."""

from __future__ import annotations

from collections.abc import Callable

from scan3d_twin.core.hal import Clock, Lidar
from scan3d_twin.devices.device import ErrorCodes, LidarDevice, LidarSensor, Wiring
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.codec import BAUDS
from scan3d_twin.devices.urg.driver import UrgLidar
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.devices.urg.lines import link_spec
from scan3d_twin.devices.urg.probe import PROBE

SCIP1, SCIP2 = "1.1", "2.0"
"""Versions of the SCIP protocol."""


def open_urg(
    open_transport: Callable[[], Transport], clock: Clock, link: str | None = None
) -> UrgLidar:
    """Return the sensor on a line; see ``LidarDevice.open_driver``."""
    return UrgLidar(open_transport, clock, None if link is None else urg04lx.LINKS[link])


def emulate_urg(lidar: Lidar, wiring: Wiring) -> UrgEmulator:
    """Return ``lidar`` as an emulated sensor; see ``LidarDevice.emulate``."""
    baud = BAUDS[0] if wiring.baud is None else wiring.baud
    return UrgEmulator(lidar, UrgProfile(wiring.usb, baud, wiring.protocol == SCIP1))


def describe_urg(lidar: UrgLidar) -> str:
    """Return product, firmware, protocol and state in one line."""
    words = [lidar.info.version.get(name, "unknown") for name in ("PROD", "FIRM", "PROT")]
    text = "{}, firmware {}, {}".format(*words)
    state = lidar.info.state.get("STAT")
    return f"{text}, state {state}" if state else text


URG04LX = LidarDevice(
    name="urg04lx",
    summary="Hokuyo URG-04LX: 682 steps of 0.35 deg at 10 Hz, to 4 m",
    links=tuple(urg04lx.LINKS),
    spec=link_spec,
    sensor=LidarSensor(
        min_range_mm=urg04lx.MIN_RANGE_MM,
        max_range_mm=urg04lx.MAX_RANGE_MM,
        detected_range_mm=urg04lx.DETECTED_RANGE_MM,
        modulations=urg04lx.MODULATIONS,
        codes=ErrorCodes(
            no_return=urg04lx.NO_RETURN,
            weak_return=urg04lx.WEAK_RETURN,
            other_error=urg04lx.NO_RETURN,
            neighbours_invalid=urg04lx.NEIGHBOURS_INVALID,
            amplitudes_differ=urg04lx.AMPLITUDES_DIFFER,
            glitch=urg04lx.GLITCH,
            too_strong=urg04lx.TOO_STRONG,
            too_far=urg04lx.TOO_FAR,
        ),
    ),
    open_driver=open_urg,
    emulate=emulate_urg,
    usb_ids={"15d1": "Hokuyo"},
    bauds=BAUDS,
    protocols=(SCIP2, SCIP1),
    sends_text=True,
    probe=PROBE,
    describe=describe_urg,
)
