"""The Roomba 500 to 800: told by their users, otherwise a Create 2; their numbers and sensors."""

import math

import pytest
from kinematic import JumpingClock, KinematicBase

from scan3d_twin.core.errors import ConfigError, LinkError
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, CommandParser
from scan3d_twin.devices.create.device import ROOMBA500, ROOMBA800
from scan3d_twin.devices.create.driver import open_create
from scan3d_twin.devices.create.emulated_body import Quirks
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.packets import DockSignal, Mode, Packet
from scan3d_twin.devices.create.roomba import step_speed
from scan3d_twin.devices.links.line_model import NO_FAULTS, Line, Wire
from scan3d_twin.devices.registry import Devices, base_device
from scan3d_twin.sim.world import robot_spec

NAMES = ["roomba500", "roomba600", "roomba700", "roomba800"]


def wire_to(model_or_device, quirks=None):
    """Return a wire to an emulated base, its clock and the emulator."""
    clock = JumpingClock(KinematicBase())
    if isinstance(model_or_device, oi.Model):
        device = CreateEmulator(clock._base, model_or_device, quirks)
    else:
        device = model_or_device.emulate(clock._base)
    return Wire(Line(device, NO_FAULTS, 0, 0.0), clock), clock, device


@pytest.mark.parametrize("name", NAMES)
def test_a_stated_roomba_is_opened_as_itself(name):
    stated = base_device(name)
    wire, clock, _ = wire_to(stated)
    base = stated.opener(is_stated=True)(wire, clock, None)
    assert base.spec == stated.spec
    assert stated.describe(base) == f"{name} at 115200 baud, mode Passive"


def test_a_roomba_that_nobody_states_is_a_create_2():
    wire, clock, _ = wire_to(ROOMBA800)
    assert open_create(wire, clock).contact.model is CREATE2


def test_a_create_1_is_no_roomba():
    wire, clock, _ = wire_to(CREATE1)
    with pytest.raises(LinkError, match="the base on the port is no roomba500"):
        ROOMBA500.open_driver(wire, clock, None)


def test_a_count_and_the_wheel_base_are_those_that_were_found_on_a_roomba_500():
    """ROS ``roomba_500_series``: 0.445558 mm a count, 235 mm; the manual of the 600 differs little.

    ``mirkosertic/roomba500``: 22.58 counts a cm, calibrated.
    """
    spec = ROOMBA500.spec
    per_count = 1000 * math.pi * spec.wheel_diameter / spec.counts_per_turn
    assert per_count == pytest.approx(0.445558, rel=0.003)
    assert per_count == pytest.approx(10 / 22.58, rel=0.006)
    assert spec.wheel_base == 0.235


@pytest.mark.parametrize(("name", "diameter"), [("roomba500", 0.330), ("roomba800", 0.353)])
def test_the_twin_and_the_planner_have_the_size_of_the_roomba(name, diameter):
    body = robot_spec(name).geom("chassis")
    assert 2 * body.size[0] == pytest.approx(diameter)
    planned = base_device(name).options["motion"]["robot_radius"]
    assert body.size[0] < planned < body.size[0] + 0.01


@pytest.mark.parametrize("opcode", [7, 173])
def test_a_roomba_500_does_not_know_the_commands_of_later_ones(opcode):
    wire, clock, device = wire_to(ROOMBA500)
    wire.write(oi.command(oi.Op.START) + bytes([opcode]))
    clock.sleep(0.1)
    wire.read(0.0)
    assert device.mode is Mode.PASSIVE
    (command,) = CommandParser(CREATE2).feed(bytes([opcode]))
    assert command.op == opcode


def test_the_left_wheel_has_packet_43_on_all_of_them():
    wire, clock, _ = wire_to(ROOMBA500)
    base = ROOMBA500.open_driver(wire, clock, None)
    base.set_velocity(0.0, 0.5)
    for _ in range(60):
        clock.sleep(0.015)
        base.service(clock.now())
    assert base.odometry().T_odom_base.yaw > 0.3


def test_the_receivers_see_the_dock():
    """Characters of the Roomba 500 dock by Fawkes: 161 force field, 164 green, 168 red, 173 all."""
    wire, clock, device = wire_to(ROOMBA500)
    signal = DockSignal
    device.body.ir = (
        signal.BASE | signal.FORCE_FIELD,
        signal.BASE | signal.RED_BUOY,
        signal.BASE | signal.RED_BUOY | signal.GREEN_BUOY | signal.FORCE_FIELD,
    )
    wire.write(
        oi.command(oi.Op.START) + oi.query([Packet.IR_OMNI, Packet.IR_LEFT, Packet.IR_RIGHT])
    )
    clock.sleep(0.1)
    assert wire.read(0.1) == bytes([161, 168, 173])
    device.body.ir = (None, None, signal.BASE | signal.GREEN_BUOY)
    wire.write(oi.query([Packet.IR_OMNI, Packet.IR_LEFT, Packet.IR_RIGHT]))
    clock.sleep(0.1)
    assert wire.read(0.1) == bytes([0, 0, 164])


def test_the_steps_of_speed_are_those_of_the_report():
    thresholds = [11, 40, 68, 97, 125, 154, 182, 211, 239, 268, 296, 325, 353, 382, 410, 439, 467]
    assert [step_speed(speed) for speed in range(-10, 11)] == [0] * 21
    for low, high in zip(thresholds, [*thresholds[1:], 496], strict=True):
        assert {step_speed(speed) for speed in range(low, high)} == {high - 1}
        assert step_speed(-low) == 1 - high
    assert {step_speed(speed) for speed in range(496, 501)} == {500}


def test_a_base_with_stepped_speeds_drives_them():
    wire, clock, device = wire_to(CREATE2, Quirks(steps_speed=True))
    wire.write(oi.command(oi.Op.START) + oi.command(oi.Op.SAFE) + oi.drive_direct(12, -10))
    clock.sleep(0.1)
    wire.read(0.0)
    assert device.wheels_mm == (39, 0)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("roomba980", "no source says what a Roomba 900 sends"),
        ("Roomba 450", "older serial interface"),
        ("roomba", "name its series"),
    ],
)
def test_what_no_source_settles_is_refused_with_the_reason(name, why):
    with pytest.raises(ConfigError, match=f"no robot '{name}': .*{why}"):
        Devices(base=name)
    with pytest.raises(ConfigError, match=why):
        base_device(name)
