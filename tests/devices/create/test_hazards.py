"""Hazards in the readings, packet by packet."""

import pytest

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.types import Hazards
from scan3d_twin.devices.create.hazards import (
    LOW_BATTERY,
    blocking_hazards,
    check_ready,
    decode_hazards,
    find_unsafe_causes,
)
from scan3d_twin.devices.create.link import COMMON
from scan3d_twin.devices.create.packets import BumpsDrops, Overcurrents, Packet

SAFE = {
    **dict.fromkeys(COMMON, 0),
    Packet.VOLTAGE: 15_000,
    Packet.CHARGE: 1000,
    Packet.CAPACITY: 2500,
    Packet.MODE: 2,
}


def with_packets(**values):
    return SAFE | {Packet[name.upper()]: value for name, value in values.items()}


def test_nothing_is_wrong_with_a_base_on_the_floor():
    assert decode_hazards(SAFE) == Hazards(battery=0.4)
    assert decode_hazards(SAFE).active() == ()


@pytest.mark.parametrize(
    ("values", "names"),
    [
        ({"bumps_drops": BumpsDrops.BUMP_LEFT}, ("bump left",)),
        ({"bumps_drops": BumpsDrops.BUMP_RIGHT}, ("bump right",)),
        ({"bumps_drops": BumpsDrops.DROP_LEFT}, ("wheel drop left",)),
        ({"bumps_drops": BumpsDrops.DROP_RIGHT}, ("wheel drop right",)),
        ({"bumps_drops": BumpsDrops.DROP_CASTER}, ("wheel drop left", "wheel drop right")),
        ({"cliff_left": 1}, ("cliff left",)),
        ({"cliff_front_left": 1}, ("cliff front left",)),
        ({"cliff_front_right": 1}, ("cliff front right",)),
        ({"cliff_right": 1}, ("cliff right",)),
        ({"overcurrents": Overcurrents.LEFT_WHEEL}, ("overcurrent left",)),
        ({"overcurrents": Overcurrents.RIGHT_WHEEL}, ("overcurrent right",)),
    ],
)
def test_every_packet_means_what_the_manual_says(values, names):
    assert decode_hazards(with_packets(**values)).active() == names


@pytest.mark.parametrize(
    ("charge", "capacity", "millivolts", "share"),
    [
        (1348, 2696, 15_000, 0.5),
        (3000, 2696, 15_000, 1.0),
        (0, 0, 14_100, 0.5),
        (0, 0, 12_600, 0.0),
        (0, 0, 11_000, 0.0),
        (0, 0, 15_600, 1.0),
        (0, 0, 16_500, 1.0),
    ],
)
def test_the_battery_is_known_by_its_charge_or_else_by_its_voltage(
    charge, capacity, millivolts, share
):
    values = with_packets(charge=charge, capacity=capacity, voltage=millivolts)
    assert decode_hazards(values).battery == pytest.approx(share)


@pytest.mark.parametrize(
    ("before", "now", "ahead", "names"),
    [
        (Hazards(), Hazards(bump_left=True), 0, ("bump left",)),
        (Hazards(bump_left=True), Hazards(bump_left=True), 0, ()),
        (Hazards(bump_left=True), Hazards(bump_left=True), 1, ("bump left",)),
        (Hazards(bump_left=True), Hazards(bump_left=True), -1, ()),
        (Hazards(bump_left=True), Hazards(cliff_left=True), -1, ("cliff left",)),
    ],
)
def test_new_hazards_stop_and_old_ones_forbid_to_drive_on(before, now, ahead, names):
    assert blocking_hazards(before, now, ahead) == names


def test_why_safe_mode_was_left():
    assert find_unsafe_causes(with_packets(charging_sources=2), Hazards()) == [
        "the charger was plugged in"
    ]
    assert find_unsafe_causes(SAFE, Hazards(wheel_drop_left=True)) == ["wheel drop left"]
    (why,) = find_unsafe_causes(SAFE, Hazards())
    assert "guard" in why


def test_a_base_on_its_charger_or_with_a_low_battery_is_not_ready():
    check_ready(Hazards(battery=LOW_BATTERY), charging=False)
    with pytest.raises(HazardError, match="on its charger"):
        check_ready(Hazards(battery=1.0), charging=True)
    with pytest.raises(HazardError, match="low battery: 9% left"):
        check_ready(Hazards(battery=0.09), charging=False)
