"""Descriptions of the iRobot Create 1 and Create 2 for the device registry.

Both share one driver, which detects the model on the line; the user may state it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from scan3d_twin.core.hal import DriveBase
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create import model
from scan3d_twin.devices.create.driver import FAREWELL, STOP, CreateBase, open_create
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.link import HALF_DRIVE
from scan3d_twin.devices.device import BaseDevice, Finding


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
    summary="iRobot Create 2 and Roomba 500 and 600: encoder counts",
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
