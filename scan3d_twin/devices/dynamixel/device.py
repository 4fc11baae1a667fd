"""Description of the Dynamixel XL330 for the device registry."""

from __future__ import annotations

from collections.abc import Iterator

from scan3d_twin.core.hal import Turntable
from scan3d_twin.devices.device import Finding, TurntableDevice
from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel.driver import Xl330Turntable
from scan3d_twin.devices.dynamixel.emulated_firmware import ServoProfile
from scan3d_twin.devices.dynamixel.emulator import Xl330Emulator
from scan3d_twin.devices.dynamixel.spec import SPEC


def describe_servo(turntable: Xl330Turntable) -> str:
    """Return model, firmware, place on the bus, supply and temperature in one line."""
    info = turntable.info
    return (
        f"Dynamixel {model.MODELS[info.model_number]}, firmware {info.firmware}, id {info.id} at "
        f"{info.baud} baud, {info.voltage:.1f} V, {info.temperature} degC"
    )


def inspect_servo(turntable: Xl330Turntable) -> Iterator[Finding]:
    """Yield whether the supply is in order."""
    low, high = model.SUPPLY
    volts = turntable.info.voltage
    is_good = low <= volts <= high
    cure = "" if is_good else f"give it {low:g} to {high:g} V, best 5 V"
    yield Finding("turntable supply", is_good, f"{volts:.1f} V", cure)


def _emulate(turntable: Turntable) -> Xl330Emulator:
    # As it is set for use, not as shipped: 50 bytes take a fifth of a service, not three
    return Xl330Emulator(turntable, ServoProfile(baud=1_000_000))


XL330 = TurntableDevice(
    name=SPEC.name,
    summary="Robotis Dynamixel XL330: a servo with a 12-bit angle sensor, 5 V, 0.5 Nm",
    spec=SPEC,
    open_driver=Xl330Turntable,
    emulate=_emulate,
    # U2D2 holds an FT232H; the boards of the maker have an id of its own.
    usb_ids={"0403:6014": "Robotis U2D2 (FT232H)", "2f5d": "Robotis"},
    describe=describe_servo,
    inspect=inspect_servo,
)
