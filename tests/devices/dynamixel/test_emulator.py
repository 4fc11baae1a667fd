"""The emulated XL330, instruction by instruction."""

import math
import struct

import pytest
from virtual import VirtualClock
from virtual_table import VirtualTable

from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel import registers as reg
from scan3d_twin.devices.dynamixel.codec import (
    ALERT,
    BROADCAST,
    ErrorNumber,
    Instruction,
    Packet,
    PacketSplitter,
)
from scan3d_twin.devices.dynamixel.emulated_firmware import BOOT, CLEAR_KEY, ServoProfile
from scan3d_twin.devices.dynamixel.emulated_motor import profile_duration
from scan3d_twin.devices.dynamixel.emulator import Xl330Emulator

OK = (ErrorNumber.NONE, b"")


class Bench:
    """An emulated servo, asked packet by packet."""

    def __init__(self, **profile):
        self.clock = VirtualClock()
        self.clock.time = 1.0
        self.table = VirtualTable(self.clock, acceleration=6.0)
        self.servo = Xl330Emulator(self.table, ServoProfile(**profile))

    def exchange(self, data, wait=0.02):
        """Send bytes; return the packets that come back, and when they began to."""
        self.servo.receive(data, self.clock.now())
        self.clock.sleep(wait)
        splitter, packets = PacketSplitter(), []
        while out := self.servo.transmit(self.clock.now()):
            packets += [(each, self.servo.began) for each in splitter.feed(out)]
        return packets

    def ask(self, instruction, params=b"", servo=1):
        """Return (error, data) of the only reply; None if there is none."""
        replies = self.exchange(Packet(servo, instruction, params).encode())
        if not replies:
            return None
        ((reply, _),) = replies
        assert reply.instruction == Instruction.STATUS
        return reply.params[0], reply.params[1:]

    def read(self, register):
        error, data = self.ask(
            Instruction.READ, struct.pack("<HH", register.address, register.size)
        )
        assert error & ~ALERT == 0
        return register.decode(data)

    def write(self, register, value):
        return self.ask(
            Instruction.WRITE, struct.pack("<H", register.address) + register.encode(value)
        )


@pytest.fixture
def bench():
    return Bench()


def test_ping_and_table_as_shipped(bench):
    assert bench.ask(Instruction.PING) == (0, struct.pack("<HB", 1200, 52))
    assert bench.ask(Instruction.PING, servo=2) is None
    shipped = {each: bench.read(each) for each in reg.REGISTERS}
    assert shipped[reg.ID] == 1
    assert model.BAUDS[shipped[reg.BAUD_RATE]] == 57600
    assert shipped[reg.OPERATING_MODE] == 3
    assert shipped[reg.VELOCITY_LIMIT] == 445
    assert shipped[reg.SHUTDOWN] == 53
    assert shipped[reg.POSITION_P] == 400
    assert shipped[reg.PRESENT_POSITION] == shipped[reg.GOAL_POSITION] == 2048
    assert shipped[reg.PRESENT_VOLTAGE] == 50


def test_a_reply_waits_for_the_return_delay(bench):
    ((_, began),) = bench.exchange(Packet(1, Instruction.PING).encode())
    assert began == pytest.approx(1.0 + 500e-6)
    bench.write(reg.RETURN_DELAY, 0)
    now = bench.clock.now()
    ((_, began),) = bench.exchange(Packet(1, Instruction.PING).encode())
    assert began == pytest.approx(now)


@pytest.mark.parametrize(
    ("register", "value", "error"),
    [
        (reg.MODEL_NUMBER, 1, ErrorNumber.ACCESS),
        (reg.PRESENT_POSITION, 1, ErrorNumber.ACCESS),
        (reg.GOAL_POSITION, 4096, ErrorNumber.LIMIT),
        (reg.GOAL_POSITION, -1, ErrorNumber.LIMIT),
        (reg.GOAL_VELOCITY, 446, ErrorNumber.LIMIT),
        (reg.GOAL_PWM, -886, ErrorNumber.LIMIT),
        (reg.BAUD_RATE, 7, ErrorNumber.RANGE),
        (reg.TORQUE, 2, ErrorNumber.RANGE),
        (reg.PROFILE_VELOCITY, 40000, ErrorNumber.RANGE),
        (reg.BUS_WATCHDOG, 128, ErrorNumber.RANGE),
    ],
)
def test_what_may_not_be_written_is_refused_and_stays(bench, register, value, error):
    before = bench.read(register)
    assert bench.write(register, value) == (error, b"")
    assert bench.read(register) == before


def test_the_eeprom_is_locked_while_the_torque_is_on(bench):
    assert bench.write(reg.OPERATING_MODE, 4) == OK
    assert bench.write(reg.TORQUE, 1) == OK
    assert bench.write(reg.OPERATING_MODE, 3) == (ErrorNumber.ACCESS, b"")
    assert bench.read(reg.OPERATING_MODE) == 4
    assert bench.write(reg.TORQUE, 0) == OK
    assert bench.write(reg.OPERATING_MODE, 3) == OK


def test_malformed_instructions_are_refused(bench):
    assert bench.ask(Instruction.WRITE, b"\x74\x00\x01") == (ErrorNumber.LENGTH, b"")
    assert bench.ask(Instruction.WRITE, b"\x76\x00\x01\x02") == (ErrorNumber.LENGTH, b"")
    assert bench.ask(Instruction.WRITE, b"\x40\x00") == (ErrorNumber.LENGTH, b"")
    assert bench.ask(Instruction.WRITE, b"\x0e\x00\x01") == (ErrorNumber.ACCESS, b"")
    assert bench.ask(Instruction.READ, b"\x84\x00") == (ErrorNumber.LENGTH, b"")
    assert bench.ask(Instruction.READ, b"\x84\x00\xff\x00") == (ErrorNumber.RANGE, b"")
    assert bench.ask(0x77) == (ErrorNumber.INSTRUCTION, b"")
    damaged = bytearray(Packet(1, Instruction.PING).encode())
    damaged[-1] ^= 1
    ((reply, _),) = bench.exchange(bytes(damaged))
    assert reply.params == bytes([ErrorNumber.CRC])


def test_half_a_packet_is_not_waited_for_for_ever(bench):
    bench.exchange(Packet(1, Instruction.WRITE, b"\x40\x00\x01").encode()[:9], wait=0.1)
    assert bench.ask(Instruction.PING)[0] == 0


def test_it_moves_by_profile_to_its_goal(bench):
    bench.write(reg.PROFILE_ACCELERATION, 16)
    bench.write(reg.PROFILE_VELOCITY, 20)
    bench.write(reg.TORQUE, 1)
    begin = bench.clock.now()
    assert bench.write(reg.GOAL_POSITION, 3000) == OK
    ((_, angle, speed),) = bench.table.orders
    assert angle == pytest.approx((3000 - 2048) * model.COUNT)
    assert speed == pytest.approx(20 * model.SPEED_UNIT)
    bench.clock.sleep(1.0)
    assert bench.read(reg.PRESENT_VELOCITY) == 20
    assert bench.read(reg.MOVING) == 1
    assert bench.read(reg.MOVING_STATUS) == model.PROFILE_ON
    bench.clock.sleep(begin + profile_duration(angle, speed, 5.99) - bench.clock.now() + 0.02)
    assert bench.read(reg.PRESENT_POSITION) == 3000
    assert bench.read(reg.MOVING_STATUS) == model.IN_POSITION
    assert bench.read(reg.MOVING) == 0


def test_without_torque_or_in_another_mode_it_does_not_move(bench):
    assert bench.write(reg.GOAL_POSITION, 3000) == OK
    bench.write(reg.OPERATING_MODE, 1)
    bench.write(reg.TORQUE, 1)
    assert bench.write(reg.GOAL_POSITION, 3000) == OK
    assert bench.table.orders == []


def test_switching_the_torque_on_holds_the_present_position(bench):
    bench.write(reg.GOAL_POSITION, 3000)
    bench.write(reg.TORQUE, 1)
    assert bench.read(reg.GOAL_POSITION) == 2048


def test_a_blocked_motion_does_not_follow(bench):
    bench.table.blocked = True
    bench.write(reg.TORQUE, 1)
    bench.write(reg.GOAL_POSITION, 3000)
    bench.clock.sleep(5.0)
    assert bench.read(reg.MOVING_STATUS) == model.NOT_FOLLOWING


def test_reverse_mode_and_homing_offset(bench):
    bench.write(reg.DRIVE_MODE, model.REVERSED)
    bench.write(reg.HOMING_OFFSET, 100)
    assert bench.read(reg.PRESENT_POSITION) == 2148
    bench.write(reg.TORQUE, 1)
    bench.write(reg.GOAL_POSITION, 2248)
    assert bench.table.orders[0][1] == pytest.approx(-100 * model.COUNT)


def test_the_bus_watchdog_stops_it_and_locks_the_goals(bench):
    bench.write(reg.TORQUE, 1)
    bench.write(reg.BUS_WATCHDOG, 5)
    bench.write(reg.PROFILE_VELOCITY, 10)
    bench.write(reg.GOAL_POSITION, 4000)
    bench.clock.sleep(0.07)
    assert bench.servo.transmit(bench.clock.now()) == b""
    assert bench.read(reg.BUS_WATCHDOG) == 5
    bench.clock.sleep(0.2)
    assert bench.read(reg.BUS_WATCHDOG) == model.WATCHDOG_EXPIRED
    stopped = bench.table.at(bench.clock.now())
    bench.clock.sleep(1.0)
    assert bench.table.at(bench.clock.now()) == stopped
    assert bench.write(reg.GOAL_POSITION, 3000) == (ErrorNumber.RANGE, b"")
    assert bench.write(reg.BUS_WATCHDOG, 0) == OK
    assert bench.write(reg.GOAL_POSITION, 3000) == OK


def test_an_overload_switches_it_off_until_a_reboot(bench):
    bench.write(reg.TORQUE, 1)
    bench.write(reg.GOAL_POSITION, 3000)
    bench.servo.firmware.fail(model.OVERLOAD_ERROR)
    assert bench.ask(Instruction.PING)[0] == ALERT
    assert bench.read(reg.TORQUE) == 0
    assert bench.read(reg.HARDWARE_ERROR) == model.OVERLOAD_ERROR
    assert bench.write(reg.TORQUE, 1) == (ALERT | ErrorNumber.FAIL, b"")
    assert bench.ask(Instruction.REBOOT) is not None
    assert bench.ask(Instruction.PING) is None
    bench.clock.sleep(BOOT)
    assert bench.read(reg.HARDWARE_ERROR) == 0
    assert bench.write(reg.TORQUE, 1) == OK


def test_an_error_outside_of_the_mask_leaves_the_torque_on(bench):
    bench.write(reg.SHUTDOWN, 0)
    bench.write(reg.TORQUE, 1)
    bench.servo.firmware.fail(model.HEAT_ERROR)
    assert bench.ask(Instruction.PING)[0] == ALERT
    assert bench.read(reg.TORQUE) == 1


def test_a_reboot_keeps_the_eeprom_and_resets_the_ram(bench):
    bench.write(reg.RETURN_DELAY, 3)
    bench.write(reg.PROFILE_VELOCITY, 20)
    bench.ask(Instruction.REBOOT)
    bench.clock.sleep(BOOT)
    assert bench.read(reg.RETURN_DELAY) == 3
    assert bench.read(reg.PROFILE_VELOCITY) == 0


@pytest.mark.parametrize(("option", "kept"), [(0xFF, 1), (0x01, 9), (0x02, 9)])
def test_a_factory_reset_keeps_what_it_is_told_to(option, kept):
    bench = Bench(id=9, baud=1_000_000)
    assert bench.ask(Instruction.FACTORY_RESET, bytes([option]), servo=9) == OK
    assert bench.servo.firmware.get(reg.ID) == kept
    assert bench.servo.firmware.baud == (1_000_000 if option == 0x02 else 57600)
    assert bench.ask(Instruction.PING, servo=kept) is None
    bench.clock.sleep(BOOT)
    assert bench.ask(Instruction.FACTORY_RESET, b"\x07", servo=kept) == (ErrorNumber.FAIL, b"")


def test_a_new_bit_rate_is_confirmed_at_the_old_one(bench):
    bench.servo.receive(Packet(1, Instruction.WRITE, b"\x08\x00\x03").encode(), 1.0)
    assert bench.servo.baud == 57600
    assert bench.servo.transmit(1.01)
    assert bench.servo.transmit(1.01) == b""
    assert bench.servo.baud == 1_000_000


def test_a_registered_write_waits_for_its_action(bench):
    bench.write(reg.TORQUE, 1)
    assert bench.ask(Instruction.ACTION) == (ErrorNumber.FAIL, b"")
    goal = struct.pack("<HI", reg.GOAL_POSITION.address, 3000)
    assert bench.ask(Instruction.REG_WRITE, goal) == OK
    assert (bench.read(reg.REGISTERED), bench.read(reg.GOAL_POSITION)) == (1, 2048)
    assert bench.ask(Instruction.ACTION, servo=BROADCAST) is None
    assert (bench.read(reg.REGISTERED), bench.read(reg.GOAL_POSITION)) == (0, 3000)


def test_clearing_turns_needs_its_key(bench):
    bench.table.turn_by_hand(2.0 * math.pi)
    assert bench.read(reg.PRESENT_POSITION) == 2048 + 4096
    assert bench.ask(Instruction.CLEAR, CLEAR_KEY) == OK
    assert bench.read(reg.PRESENT_POSITION) == 2048
    assert bench.ask(Instruction.CLEAR, b"\x01") == (ErrorNumber.FAIL, b"")


@pytest.mark.parametrize("level", [0, 1, 2])
def test_the_status_return_level_says_what_is_answered(bench, level):
    bench.write(reg.STATUS_RETURN_LEVEL, level)
    assert bench.ask(Instruction.PING) is not None
    asked = bench.ask(Instruction.READ, struct.pack("<HH", 132, 4))
    assert (asked is not None) == (level >= 1)
    assert (bench.write(reg.LED, 1) is not None) == (level == 2)


def test_broadcasts_are_carried_out_and_only_a_ping_is_answered(bench):
    assert bench.ask(Instruction.PING, servo=BROADCAST)[0] == 0
    assert bench.ask(Instruction.WRITE, b"\x41\x00\x01", servo=BROADCAST) is None
    assert bench.read(reg.LED) == 1
    assert bench.ask(Instruction.READ, struct.pack("<HH", 132, 4), servo=BROADCAST) is None


def test_groups_are_answered_by_the_first_of_the_list(bench):
    place = struct.pack("<HH", 132, 2)
    position = (0, struct.pack("<H", 2048))
    assert bench.ask(Instruction.SYNC_READ, place + b"\x01\x05", BROADCAST) == position
    assert bench.ask(Instruction.SYNC_READ, place + b"\x05\x01", BROADCAST) is None
    assert bench.ask(Instruction.BULK_READ, b"\x01" + place, BROADCAST) == position
    written = struct.pack("<HH", 65, 1) + b"\x05\x00\x01\x01"
    assert bench.ask(Instruction.SYNC_WRITE, written, BROADCAST) is None
    assert bench.read(reg.LED) == 1
    bench.ask(Instruction.BULK_WRITE, b"\x01" + struct.pack("<HH", 65, 1) + b"\x00", BROADCAST)
    assert bench.read(reg.LED) == 0


def test_the_timer_counts_milliseconds_and_wraps():
    bench = Bench(tick_ms=32000, skew=0.01)
    assert bench.read(reg.REALTIME_TICK) == (32000 + 1010) % 32768


def test_an_adapter_that_echoes_sends_the_question_first():
    bench = Bench(echo=True)
    (question, _), (reply, _) = bench.exchange(Packet(1, Instruction.PING).encode())
    assert question == Packet(1, Instruction.PING)
    assert reply.instruction == Instruction.STATUS


def test_the_duration_of_a_profile():
    assert profile_duration(3.0, 1.0, 0.0) == 3.0
    assert profile_duration(3.0, 1.0, 1.0) == 4.0
    assert profile_duration(0.25, 1.0, 1.0) == 1.0
