"""Descriptions of the iRobot Create 1, Create 2 and Roomba 500 to 800 for the device registry.

All share one driver, which tells a Create 1 from the others on the line; the user may state it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from scan3d_twin.core.hal import DriveBase
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create import model, roomba
from scan3d_twin.devices.create.driver import FAREWELL, STOP, CreateBase, open_create
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.link import HALF_DRIVE, base_spec
from scan3d_twin.devices.device import BaseDevice, Finding

BODY_MARGIN = 0.005
"""What the planner adds to the radius of the body [m]: 0.17 m for the 0.165 m of a Create."""


def emulate_create1(base: DriveBase) -> CreateEmulator:
    """Return ``base`` as an emulated Create 1."""
    return CreateEmulator(base, oi.CREATE1)


def emulate_create2(base: DriveBase) -> CreateEmulator:
    """Return ``base`` as an emulated Create 2."""
    return CreateEmulator(base, oi.CREATE2)


def describe_create(base: CreateBase) -> str:
    """Return in one line which base was found, its baud rate and its mode."""
    contact = base.contact
    offset = ", mode reported one too high" if contact.mode_offset else ""
    mode = base.mode.name.title()
    return f"{contact.model.name} at {contact.baud} baud, mode {mode}{offset}"


def inspect_create(base: CreateBase) -> Iterator[Finding]:
    """Yield a warning if the charger is plugged in."""
    if base.charging:
        yield Finding("base charger", False, "plugged in", "unplug it to drive")


CREATE2 = BaseDevice(
    name="create2",
    summary="iRobot Create 2: encoder counts",
    spec=model.CREATE2,
    open_driver=open_create,
    emulate=emulate_create2,
    open_stated=partial(open_create, stated=oi.CREATE2),
    # The cable that comes with the Create 2 holds an FTDI.
    usb_ids={"0403": "FTDI", "067b": "Prolific", "10c4": "Silicon Labs", "1a86": "WCH"},
    halt=HALF_DRIVE + STOP,
    farewell=HALF_DRIVE + FAREWELL,
    describe=describe_create,
    inspect=inspect_create,
)
CREATE1 = replace(
    CREATE2,
    name="create1",
    summary="iRobot Create 1: odometry by the commands, corrected at rest",
    spec=model.CREATE1,
    emulate=emulate_create1,
    open_stated=partial(open_create, stated=oi.CREATE1),
    counts=False,
)


def describe_roomba(stated: oi.Model, summary: str) -> BaseDevice:
    """Return the description of a Roomba: a Create 2 of other numbers."""
    return replace(
        CREATE2,
        name=stated.name,
        summary=summary,
        spec=base_spec(stated, streams=True),
        emulate=lambda base: CreateEmulator(base, stated),
        open_driver=partial(open_create, stated=stated),
        open_stated=None,
        options={
            "motion": {"robot_radius": stated.radius_mm / 1000 + BODY_MARGIN},
            # The slowest turn that all of them drive: 5.4 deg/s
            "sweep": {"yaw_rate": 2 * stated.min_speed_mm / stated.wheel_base_mm},
        },
    )


ROOMBA500 = describe_roomba(roomba.ROOMBA500, "iRobot Roomba 500 series, as a Create 2")
ROOMBA600 = describe_roomba(roomba.ROOMBA600, "iRobot Roomba 600 series, as a Create 2")
ROOMBA700 = describe_roomba(roomba.ROOMBA700, "iRobot Roomba 700 series, as a larger Create 2")
ROOMBA800 = describe_roomba(roomba.ROOMBA800, "iRobot Roomba 800 series, as a larger Create 2")
