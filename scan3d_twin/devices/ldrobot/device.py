"""Descriptions of the LDROBOT LD06, LD19 and STL27L for the device registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from scan3d_twin.core.hal import Clock, Lidar
from scan3d_twin.devices.device import ConfigTables, LidarDevice, LidarSensor, Wiring
from scan3d_twin.devices.ldrobot import model as ld
from scan3d_twin.devices.ldrobot.driver import LdLidar
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.ldrobot.model import LdModel
from scan3d_twin.devices.ldrobot.probe import PROBE
from scan3d_twin.devices.links.transport import Transport


def describe_ld(lidar: LdLidar) -> str:
    """Return model, turn rate and damage in one line."""
    return (
        f"{lidar.model.name}, {lidar.speed:.1f} turns/s, {lidar.model.readings:.0f} readings a "
        f"turn, {lidar.bad} packets dropped"
    )


def _describe_device(
    model: LdModel,
    summary: str,
    errors: Mapping[str, float | bool],
    options: ConfigTables,
) -> LidarDevice:
    """Return the description of ``model``."""

    def open_ld(
        open_transport: Callable[[], Transport], clock: Clock, link: str | None = None
    ) -> LdLidar:
        return LdLidar(open_transport, clock, model)

    def emulate_ld(lidar: Lidar, wiring: Wiring) -> LdEmulator:
        return LdEmulator(lidar, model, usb=wiring.usb)

    return LidarDevice(
        name=model.name.lower(),
        summary=summary,
        links=(model.link,),
        spec=lambda link: model.spec,
        sensor=LidarSensor(model.min_range_mm, model.max_range_mm, drops_isolated=False),
        open_driver=open_ld,
        emulate=emulate_ld,
        usb_links=(),
        # The adapter that is sold with them holds a CP2102.
        usb_ids={"10c4:ea60": "Silicon Labs"},
        bauds=(model.baud,),
        sample_rate=lambda link: model.sample_rate,
        sends_text=True,
        probe=PROBE,
        describe=describe_ld,
        options={
            "lidar": {**ld.COMMON_ERRORS, **errors},
            "planning": {"sigma": errors["sigma"]},
            **options,
        },
    )


LD_OPTIONS = {"registration": ld.LD_REGISTRATION, "target": {"floor_height": ld.FLOOR_HEIGHT}}
LD06 = _describe_device(
    ld.LD06,
    "LDROBOT LD06: all round, 450 readings a turn at 10 Hz, to 12 m",
    ld.LD_ERRORS,
    LD_OPTIONS,
)
LD19 = _describe_device(
    ld.LD19,
    "LDROBOT LD19: all round, 450 readings a turn at 10 Hz, to 12 m",
    ld.LD_ERRORS,
    LD_OPTIONS,
)
STL27L = _describe_device(
    ld.STL27L,
    "LDROBOT STL27L: all round, 2160 readings a turn at 10 Hz, to 25 m",
    ld.STL27L_ERRORS,
    {"registration": ld.STL27L_REGISTRATION},
)
