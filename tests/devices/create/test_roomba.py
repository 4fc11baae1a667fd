"""The Roomba 500 to 800: told by their users, otherwise a Create 2; their numbers and sensors."""

import logging
import math

import pytest
from kinematic import JumpingClock, KinematicBase

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.errors import ConfigError, LinkError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.motion_control import turn_by
from scan3d_twin.core.navigation.wheel_kinematics import split_velocity
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, CommandParser
from scan3d_twin.devices.create.device import ROOMBA500, ROOMBA800
from scan3d_twin.devices.create.driver import open_create
from scan3d_twin.devices.create.emulation.body import Quirks
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.packets import DockSignal, Mode, Packet
from scan3d_twin.devices.create.roomba import ROOMBA600, step_speed
from scan3d_twin.devices.links.line_model import NO_FAULTS, Line, Wire
from scan3d_twin.devices.registry import Devices, base_device
from scan3d_twin.real.robot import ServicedClock
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


def roomba(quirks=None, model=ROOMBA600):
    """Return a robot without a lidar: the driver on an emulated Roomba, in virtual time."""
    return wired_roomba(model, quirks)[0]


def wired_roomba(model, quirks=None):
    """Return the same, and the emulated base."""
    wire, clock, device = wire_to(model, quirks)
    serviced = ServicedClock(clock)
    base = open_create(wire, serviced, stated=model)
    serviced.attach(base)
    return Robot(base, None, serviced), device


@pytest.mark.parametrize("stepped", [False, True])
@pytest.mark.parametrize("degrees", [30, -3, 1, 0.7])
def test_a_roomba_finishes_small_turns_whether_its_speeds_have_steps_or_not(stepped, degrees):
    """Below 11 mm/s its wheels may stand: a turn of 1 deg would never end."""
    robot = roomba(Quirks(steps_speed=stepped))
    turn_by(robot, math.radians(degrees), MotionConfig())
    robot.clock.sleep(0.5)
    yaw = robot.base.odometry().T_odom_base.yaw
    assert math.degrees(yaw) == pytest.approx(degrees, abs=1.0)


@pytest.mark.parametrize("name", NAMES)
def test_the_sweep_of_a_roomba_is_the_slowest_turn_that_it_drives(name):
    device = base_device(name)
    rate = device.options["sweep"]["yaw_rate"]
    left, right = split_velocity(device.spec, 0.0, rate)
    assert (left, right) == pytest.approx((-0.011, 0.011), abs=1e-9)
    assert math.degrees(rate) == pytest.approx(5.36, abs=0.01)


def test_too_slow_a_command_is_sped_up_on_the_same_path():
    left, right = split_velocity(ROOMBA500.spec, 0.003, 0.02)
    assert right == pytest.approx(0.011, abs=1e-9)
    assert left == pytest.approx(0.011 * (0.003 - 0.00235) / (0.003 + 0.00235), abs=0.0005)
    assert split_velocity(ROOMBA500.spec, 0.0, 0.0) == (0.0, 0.0)


def test_an_emulated_roomba_stands_when_told_less_than_it_drives():
    wire, clock, device = wire_to(ROOMBA500)
    wire.write(oi.command(oi.Op.START) + oi.command(oi.Op.SAFE) + oi.drive_direct(10, -10))
    clock.sleep(0.1)
    wire.read(0.0)
    assert device.wheels_mm == (0, 0)


@pytest.mark.parametrize(
    ("stepped", "rate", "warned"),
    [(True, 0.09, True), (True, 0.332, False), (False, 0.09, False), (False, 0.332, False)],
)
def test_a_base_whose_speeds_have_steps_is_named(caplog, stepped, rate, warned):
    robot = roomba(Quirks(steps_speed=stepped))
    with caplog.at_level(logging.WARNING):
        robot.base.set_velocity(0.0, rate)
        robot.clock.sleep(3.0)
    said = [record.getMessage() for record in caplog.records]
    assert [text for text in said if "knows only a few speeds" in text] == said
    assert len(said) == warned
    assert not warned or said[0].startswith("the base drives 39 and -39 mm/s where it was told 11")


def test_a_base_that_a_busy_computer_halts_is_not_taken_for_one_with_few_speeds(caplog):
    """The guard stops it again and again, so that it turns by a third of what it was told."""
    robot, device = wired_roomba(CREATE2)
    with caplog.at_level(logging.WARNING):
        robot.base.set_velocity(0.0, math.radians(5.0))
        for _ in range(20):
            device.receive(oi.drive_direct(0, 0), robot.clock.now())
            robot.clock.sleep(0.15)
    assert caplog.records == []


def test_a_create_2_that_stands_where_it_should_turn_slowly_is_named(caplog):
    robot = roomba(Quirks(steps_speed=True), CREATE2)
    with caplog.at_level(logging.WARNING):
        robot.base.set_velocity(0.0, math.radians(5.0))
        robot.clock.sleep(3.0)
    (record,) = caplog.records
    assert record.getMessage().startswith("the base drives 0 and 0 mm/s where it was told 10")


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
