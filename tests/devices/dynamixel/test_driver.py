"""The driver of the XL330, by dynamixel-sdk, against the emulated one, in virtual time."""

import math
import struct
from itertools import pairwise

import pytest
from virtual import VirtualClock
from virtual_table import VirtualTable

from scan3d_twin.core.errors import ConfigError, HazardError, LinkError, LinkTimeoutError
from scan3d_twin.devices.dynamixel import codec, model
from scan3d_twin.devices.dynamixel import registers as reg
from scan3d_twin.devices.dynamixel.codec import Instruction, Packet, PacketSplitter
from scan3d_twin.devices.dynamixel.device import describe_servo, inspect_servo
from scan3d_twin.devices.dynamixel.driver import Xl330Turntable
from scan3d_twin.devices.dynamixel.emulated_firmware import Reply, ServoProfile
from scan3d_twin.devices.dynamixel.emulator import Xl330Emulator
from scan3d_twin.devices.dynamixel.link import ServoLink
from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.links.transport import Tapped

SLICE = 0.005
"""Interval at which the robot's clock services its drivers [s]."""


class Bench:
    """A servo on a table: emulated, its line and its clock."""

    def __init__(self, profile=None, faults=None, seed=0, angle=0.3, latency=0.0):
        self.clock = VirtualClock()
        self.clock.time = 1.0
        self.table = VirtualTable(self.clock, angle)
        self.servo = Xl330Emulator(self.table, profile or ServoProfile(baud=1_000_000))
        self.line = Line(self.servo, faults or Faults(), seed, latency)
        self.sent = b""
        self.driver = None

    @property
    def firmware(self):
        return self.servo.firmware

    def open_transport(self):
        return Tapped(Wire(self.line, self.clock), self.clock, self._tap)

    def _tap(self, stamp, direction, data):
        if direction == ">":
            self.sent += data

    def connect(self):
        self.driver = Xl330Turntable(self.open_transport, self.clock)
        return self.driver

    def run(self, seconds):
        """Let time pass as the robot's clock does."""
        until = self.clock.now() + seconds
        while self.clock.now() < until - 1e-9:
            self.clock.sleep(SLICE)
            self.driver.service(self.clock.now())

    def writes(self):
        """Return the (address, first byte) of all that was written."""
        packets = PacketSplitter().feed(self.sent)
        wrote = [each.params for each in packets if each.instruction == Instruction.WRITE]
        return [(struct.unpack("<H", params[:2])[0], params[2]) for params in wrote]

    def worst(self, since=0.0):
        """Return the largest error of an angle [counts]."""
        angles = self.driver.angles_since(since)
        return max(abs(each.angle - self.table.at(each.stamp)) for each in angles) / model.COUNT


@pytest.fixture
def bench():
    return Bench()


STATES = {
    "as shipped": (ServoProfile(), {}),
    "set for use": (ServoProfile(baud=1_000_000), {reg.RETURN_DELAY: 0}),
    "another id": (ServoProfile(id=7), {}),
    "fast": (ServoProfile(baud=4_000_000), {}),
    "in velocity mode": (ServoProfile(), {reg.OPERATING_MODE: 1}),
    "with profiles by time": (ServoProfile(), {reg.DRIVE_MODE: 4}),
    "silent": (ServoProfile(), {reg.STATUS_RETURN_LEVEL: 0}),
    "left with its torque on": (ServoProfile(torque=True), {}),
    "stopped by its guard": (ServoProfile(torque=True), {reg.BUS_WATCHDOG: 0xFF}),
    "overloaded": (ServoProfile(hardware_error=model.OVERLOAD_ERROR), {}),
    "behind an adapter that echoes": (ServoProfile(echo=True), {}),
}


@pytest.mark.parametrize("state", STATES)
def test_it_connects_from_any_state_without_moving_and_turns(state):
    profile, registers = STATES[state]
    bench = Bench(profile)
    for register, value in registers.items():
        bench.firmware.put(register, value)
    driver = bench.connect()
    assert bench.clock.now() < 8.5
    assert bench.table.orders == []
    assert driver.angle().angle == pytest.approx(0.3, abs=model.COUNT)
    driver.turn_to(0.6, 1.0)
    bench.run(1.0)
    assert driver.angle().angle == pytest.approx(0.6, abs=model.COUNT)
    assert bench.worst() < 0.51
    assert (driver.bad, driver.stats.reconnects) == (0, 0)


def test_a_torque_that_others_left_on_stays_on_where_nothing_is_to_turn():
    bench = Bench(ServoProfile(torque=True))
    bench.firmware.put(reg.OPERATING_MODE, model.MULTI_TURN_MODE)
    bench.firmware.put(reg.RETURN_DELAY, 0)
    bench.connect()
    bench.run(1.0)
    bench.driver.close()
    assert bench.driver.stats.reconnects == 0
    assert bench.firmware.get(reg.TORQUE) == 1
    assert bench.table.orders == []


def test_as_it_is_found_so_it_is_described(bench):
    bench.connect()
    text = "Dynamixel XL330-M288, firmware 52, id 1 at 1000000 baud, 5.0 V, 32 degC"
    assert describe_servo(bench.driver) == text
    (finding,) = inspect_servo(bench.driver)
    assert finding.ok
    weak = Bench(ServoProfile(voltage=3.4))
    (finding,) = inspect_servo(weak.connect())
    assert not finding.ok
    assert "best 5 V" in finding.cure


def test_the_limits_are_those_set_in_the_servo(bench):
    bench.firmware.put(reg.MIN_POSITION, 1024)
    bench.firmware.put(reg.MAX_POSITION, 3072)
    bench.firmware.put(reg.VELOCITY_LIMIT, 100)
    driver = bench.connect()
    assert driver.spec.min_angle == -math.pi / 2
    assert driver.spec.max_angle == math.pi / 2
    assert driver.spec.max_speed == pytest.approx(100 * model.SPEED_UNIT)
    assert driver.turn_to(2.0, 50.0) == (driver.spec.max_angle, driver.spec.max_speed)
    assert driver.turn_to(-2.0, 1.0)[0] == driver.spec.min_angle


def test_without_limits_it_turns_as_far_as_the_cable_allows(bench):
    driver = bench.connect()
    assert bench.firmware.get(reg.OPERATING_MODE) == model.MULTI_TURN_MODE
    goal, _ = driver.turn_to(100.0, 3.0)
    assert math.radians(199.9) < goal == pytest.approx(driver.spec.max_angle, abs=model.COUNT)
    bench.run(3.5)
    assert driver.angle().angle == pytest.approx(goal, abs=model.COUNT)


@pytest.mark.parametrize("angle", [math.radians(195.0), math.radians(-195.0)])
def test_a_servo_that_forgets_whole_turns_does_not_wind_up_the_cable(bench, angle):
    driver = bench.connect()
    driver.turn_to(angle, 3.0)
    bench.run(3.0)
    bench.servo.firmware = Xl330Emulator(
        bench.table, ServoProfile(baud=1_000_000, tick_ms=-3500)
    ).firmware
    assert 0 <= bench.firmware.get(reg.GOAL_POSITION) < model.COUNTS
    bench.run(2.0)
    assert driver.stats.reconnects == 1
    assert driver.angle().angle == pytest.approx(angle, abs=2 * model.COUNT)
    driver.turn_to(0.0, 3.0)
    bench.run(3.0)
    assert driver.angle().angle == pytest.approx(0.0, abs=model.COUNT)
    assert bench.table.at(bench.clock.now()) == pytest.approx(0.0, abs=model.COUNT)
    assert bench.worst() < 0.51


@pytest.mark.parametrize(("angle", "speed"), [(math.nan, 1.0), (0.0, 0.0), (0.0, -1.0)])
def test_what_is_no_motion_is_refused(bench, angle, speed):
    with pytest.raises(ConfigError, match="a turntable turns to an angle at a speed > 0"):
        bench.connect().turn_to(angle, speed)


@pytest.mark.parametrize("speed", [1e-6, 0.01, 0.023, 0.5, 3.0])
def test_the_speed_is_rounded_but_never_to_none_which_is_the_fastest(bench, speed):
    driver = bench.connect()
    _, sent = driver.turn_to(0.31, speed)
    assert sent >= model.SPEED_UNIT
    assert abs(sent - max(speed, model.SPEED_UNIT)) <= model.SPEED_UNIT / 2
    bench.run(0.1)
    assert bench.table.orders[-1][2] == pytest.approx(sent)
    assert bench.firmware.get(reg.PROFILE_VELOCITY) == round(sent / model.SPEED_UNIT)


def test_the_order_is_torque_off_mode_delay_guard_profile_torque_goal():
    bench = Bench(ServoProfile(torque=True))
    bench.firmware.put(reg.OPERATING_MODE, 1)
    bench.connect().turn_to(0.5, 1.0)
    bench.run(0.1)
    assert bench.writes() == [
        (reg.STATUS_RETURN_LEVEL.address, 2),
        (reg.TORQUE.address, 0),
        (reg.OPERATING_MODE.address, model.MULTI_TURN_MODE),
        (reg.RETURN_DELAY.address, 0),
        (reg.BUS_WATCHDOG.address, 0),
        (reg.PROFILE_ACCELERATION.address, 5),
        (reg.TORQUE.address, 1),
        (reg.BUS_WATCHDOG.address, 15),
        (reg.PROFILE_ACCELERATION.address, 5),
    ]


def test_what_is_set_already_is_not_written_to_the_eeprom_again(bench):
    bench.connect().close()
    bench.sent = b""
    bench.connect()
    assert [address for address, _ in bench.writes() if address < reg.RAM] == []


@pytest.mark.parametrize("baud", [57600, 1_000_000])
def test_angles_come_as_often_as_the_spec_says(baud):
    bench = Bench(ServoProfile(baud=baud))
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    start = bench.clock.now()
    bench.run(3.0)
    angles = driver.angles_since(start + 0.1)
    steps = [b.stamp - a.stamp for a, b in pairwise(angles)]
    assert max(steps) <= driver.spec.sample_period
    assert min(steps) > driver.spec.sample_period / 2 - 1e-3
    assert bench.worst() < 0.51


def test_angles_since_begins_before_the_time_asked_for(bench):
    driver = bench.connect()
    bench.run(0.5)
    stamps = [each.stamp for each in driver.angles_since(-1.0)]
    assert stamps == sorted(stamps)
    assert [each.stamp for each in driver.angles_since(stamps[20] + 1e-6)] == stamps[20:]
    assert driver.angles_since(1e9) == (driver.angle(),)


def test_a_servo_whose_clock_is_off_is_stamped_by_ours():
    bench = Bench(ServoProfile(skew=0.0003, tick_ms=31000))
    driver = bench.connect()
    for k in range(3):
        driver.turn_to((-1) ** k, 0.5)
        bench.run(4.0)
    # A tick and 10 s of skew at the speed of the motion
    assert bench.worst() < 0.5 + 0.5 * (0.001 + 0.003) / model.COUNT
    assert driver.bad == 0


def test_stop_ends_a_motion_and_takes_back_one_that_has_not_begun(bench):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(1.0)
    driver.stop()
    reached = bench.table.at(bench.clock.now())
    bench.run(1.0)
    assert driver.angle().angle == pytest.approx(reached + 0.5**2 / 4, abs=0.02)
    assert len(bench.table.orders) == 2
    driver.stop()
    bench.run(0.5)
    assert len(bench.table.orders) == 2

    still = Bench()
    driver = still.connect()
    driver.stop()
    driver.turn_to(2.0, 0.5)
    driver.stop()
    still.run(0.5)
    assert still.table.orders == []


def test_a_new_order_replaces_the_one_under_way(bench):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    driver.turn_to(0.0, 1.0)
    bench.run(3.0)
    assert driver.angle().angle == pytest.approx(0.0, abs=model.COUNT)


def test_the_guard_is_armed_in_motion_and_off_at_rest(bench):
    driver = bench.connect()
    driver.turn_to(0.8, 1.0)
    bench.run(0.3)
    assert bench.firmware.get(reg.BUS_WATCHDOG) * model.WATCHDOG_UNIT == model.WATCHDOG
    bench.run(1.0)
    assert bench.firmware.get(reg.BUS_WATCHDOG) == 0
    bench.clock.sleep(20.0)
    bench.run(0.1)
    assert bench.firmware.get(reg.BUS_WATCHDOG) == 0
    assert bench.firmware.get(reg.TORQUE) == 1
    assert len(bench.table.orders) == 1


def test_a_program_that_dies_in_motion_leaves_it_standing(bench):
    bench.connect().turn_to(3.0, 0.5)
    bench.run(1.0)
    last = bench.clock.now()
    wire = Wire(bench.line, bench.clock, 1_000_000)
    while bench.clock.now() < last + 3.0:
        wire.read(0.1)
    assert bench.table.at(last + 1.0) == bench.table.at(last + 3.0)
    assert bench.table.at(last + 3.0) - bench.table.at(last) < 0.5 * (model.WATCHDOG + 0.11)


def test_a_program_that_hung_goes_on(bench, caplog):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    bench.clock.sleep(2.0)
    bench.firmware.watch(bench.clock.now())
    assert bench.firmware.get(reg.BUS_WATCHDOG) == model.WATCHDOG_EXPIRED
    bench.run(5.0)
    assert driver.angle().angle == pytest.approx(2.0, abs=model.COUNT)
    assert "this program was silent; it goes on" in caplog.text
    assert bench.worst() < 0.51
    assert driver.bad <= 1


def test_a_guard_that_expires_between_arming_and_goal_is_armed_again(bench):
    driver = bench.connect()
    driver.turn_to(1.0, 0.5)
    while bench.firmware.get(reg.BUS_WATCHDOG) == 0:
        bench.run(SLICE)
    bench.firmware.put(reg.BUS_WATCHDOG, model.WATCHDOG_EXPIRED)
    bench.run(3.0)
    assert driver.angle().angle == pytest.approx(1.0, abs=model.COUNT)


@pytest.mark.parametrize(
    ("bits", "reason"),
    [
        (model.OVERLOAD_ERROR, "it was overloaded; free what it turns"),
        (model.HEAT_ERROR, "it is too hot; let it cool down"),
        (model.VOLTAGE_ERROR, "its supply voltage is out of range; give it 5 V"),
        (
            model.HEAT_ERROR | model.OVERLOAD_ERROR,
            "it is too hot and it was overloaded; let it cool",
        ),
    ],
)
def test_a_shutdown_is_a_hazard_with_reason_and_cure(bench, bits, reason):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    bench.firmware.fail(bits)
    failed = bench.clock.now()
    with pytest.raises(HazardError, match=f"switched its torque off: {reason}"):
        bench.run(1.0)
    assert bench.clock.now() < failed + 0.05
    bench.run(0.5)
    assert driver.angle().stamp > failed + 0.4
    with pytest.raises(HazardError, match="switched its torque off"):
        driver.turn_to(0.0, 0.5)
    driver.close()
    Bench.connect(bench).turn_to(0.0, 1.0)
    bench.run(3.0)
    assert bench.driver.angle().angle == pytest.approx(0.0, abs=model.COUNT)


def test_a_warning_that_leaves_the_torque_on_is_no_hazard(bench):
    bench.firmware.put(reg.SHUTDOWN, 0)
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    bench.firmware.fail(model.HEAT_ERROR)
    bench.run(5.0)
    assert driver.angle().angle == pytest.approx(2.0, abs=model.COUNT)


def test_an_error_that_a_reboot_does_not_mend_is_said():
    bench = Bench(ServoProfile(hardware_error=model.HEAT_ERROR, broken=True))
    with pytest.raises(LinkError, match="does not work: it is too hot; let it cool"):
        bench.connect()


def test_another_model_is_named():
    bench = Bench(ServoProfile(model_number=1060))
    with pytest.raises(LinkError, match=r"is of model 1060, not XL330-M288 \(1200\) or XL330-M077"):
        bench.connect()


def test_nobody_on_the_line_is_an_error_in_time_that_says_what_to_check(bench):
    bench.servo.receive = lambda data, now: None
    with pytest.raises(LinkTimeoutError, match=r"no Dynamixel answers at 1000000, 57600,.* 5 V"):
        bench.connect()
    assert bench.clock.now() < 8.0


def test_another_device_on_the_line_is_no_servo():
    class Chatter:
        """Sends text all the time."""

        baud = 0

        def receive(self, data, now):
            pass

        def transmit(self, now):
            text, self.sent = (b"chatter\n", True) if not hasattr(self, "sent") else (b"", True)
            return text

    bench = Bench()
    bench.line.device = Chatter()
    with pytest.raises(LinkTimeoutError, match="no Dynamixel answers"):
        bench.connect()


def test_unplugged_in_motion_it_connects_again_and_goes_on(bench):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    bench.line.plugged = False
    bench.run(3.0)
    assert driver.stats.problem
    lost = driver.angle().stamp
    assert lost < 2.0
    bench.line.plugged = True
    bench.run(5.0)
    assert driver.stats.reconnects == 1
    assert driver.stats.problem == ""
    assert driver.angle().angle == pytest.approx(2.0, abs=model.COUNT)
    assert bench.worst() < 0.51


def test_unplugged_at_rest_it_connects_again_and_stays(bench):
    driver = bench.connect()
    driver.turn_to(0.5, 1.0)
    bench.run(1.0)
    bench.line.plugged = False
    bench.run(1.0)
    bench.line.plugged = True
    bench.run(1.5)
    assert driver.stats.reconnects == 1
    assert len(bench.table.orders) == 1


def test_a_servo_that_lost_its_power_for_a_moment_is_set_up_again(bench):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.7)
    bench.servo.firmware = Xl330Emulator(
        bench.table, ServoProfile(baud=1_000_000, tick_ms=-1700)
    ).firmware
    bench.run(6.0)
    assert driver.stats.reconnects == 1
    assert bench.firmware.get(reg.TORQUE) == 1
    assert driver.angle().angle == pytest.approx(2.0, abs=model.COUNT)


def test_turned_by_hand_it_is_believed_after_a_few_readings(bench):
    driver = bench.connect()
    bench.run(0.2)
    bench.table.turn_by_hand(-1.5)
    bench.run(0.2)
    assert driver.angle().angle == pytest.approx(-1.5, abs=model.COUNT)


def test_closing_lets_go_and_leaves_nothing_armed(bench):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    driver.close()
    assert bench.firmware.get(reg.TORQUE) == 0
    assert bench.firmware.get(reg.BUS_WATCHDOG) == 0
    closed = bench.clock.now()
    bench.clock.sleep(1.0)
    assert bench.table.at(bench.clock.now()) == bench.table.at(closed)
    driver.close()


def test_closing_an_unplugged_one_is_no_error(bench):
    driver = bench.connect()
    driver.turn_to(2.0, 0.5)
    bench.run(0.5)
    bench.line.plugged = False
    driver.close()


@pytest.mark.parametrize("latency", [0.001, 0.016])
def test_a_slow_adapter_costs_readings_not_accuracy(latency):
    bench = Bench(latency=latency)
    driver = bench.connect()
    driver.turn_to(2.0, 1.0)
    start = bench.clock.now()
    bench.run(1.0)
    count = len(driver.angles_since(start))
    assert count > 150 if latency < 0.005 else 40 < count < 60
    assert bench.worst() < 0.51
    assert driver.bad == 0


@pytest.mark.parametrize("delay", [0.035, 0.04, 0.05])
def test_an_answer_that_comes_late_is_not_taken_for_the_next_one(bench, delay):
    driver = bench.connect()
    firmware, asked = bench.firmware, []

    def answer(packet, now):
        asked.append(now)
        late = delay if len(asked) % 40 == 0 else 0.0
        return [Reply(reply.data, reply.wait + late) for reply in answered(packet, now)]

    answered, firmware.answer = firmware.answer, answer
    driver.turn_to(2.0, 1.0)
    bench.run(2.5)
    assert driver.bad >= 4
    assert bench.worst() < 0.51


@pytest.mark.parametrize("rate", [0.001, 0.004])
def test_on_a_bad_line_no_wrong_angle_is_believed(rate):
    bench = Bench()
    driver = bench.connect()
    bench.line.faults = Faults(drop=rate, insert=rate, flip=rate)
    for k in range(3):
        driver.turn_to((-1) ** k, 1.0)
        bench.run(2.8)
        assert bench.table.orders[-1][1] == pytest.approx((-1) ** k, abs=model.COUNT)
    assert bench.worst() < 0.51
    assert driver.bad > 10
    assert driver.stats.good > 100


def ask(bench, servo, reply):
    """Return what the driver's link makes of a ``reply`` to a read of 8 bytes at 128."""

    class Answering:
        baud = 1_000_000

        def __init__(self):
            self.out = b""

        def receive(self, data, now):
            self.out = reply

        def transmit(self, now):
            out, self.out = self.out, b""
            return out

    link = ServoLink(Wire(Line(Answering()), bench.clock), bench.clock, 1_000_000)
    steps = link.read(servo, 128, 136, attempts=1)
    try:
        while True:
            next(steps)
            bench.clock.sleep(SLICE)
    except StopIteration as done:
        return done.value.data


def test_a_stuffed_answer_is_read(bench):
    data = bytes.fromhex("FDFFFFFFFFFFFD00")
    assert ask(bench, 1, codec.encode_status(1, 0, data)) == data


def test_what_the_sdk_shortens_wrongly_is_no_answer(bench):
    """It takes FF FD FD for stuffing once it has removed some: the manual's own is FF FF FD FD."""
    reply = codec.encode_status(1, 0, bytes.fromhex("FFFFFD00FFFDFD05"))
    with pytest.raises(LinkTimeoutError):
        ask(bench, 1, reply)


@pytest.mark.parametrize(
    "reply",
    [
        codec.encode_status(2, 0, bytes(8)),
        codec.encode_status(1, 0, bytes(4)),
        codec.encode_status(1, 0),
        codec.encode_status(1, 0, bytes(8))[:-1],
        Packet(1, Instruction.READ, bytes(8)).encode(),
    ],
)
def test_other_answers_are_none(bench, reply):
    with pytest.raises(LinkTimeoutError):
        ask(bench, 1, reply)


def test_an_answer_behind_others_is_found(bench):
    late, good = codec.encode_status(1, 0), codec.encode_status(1, 0, bytes(range(8)))
    assert ask(bench, 1, b"\xff\xff\x00" + late + good) == bytes(range(8))


def test_a_refusal_is_named(bench):
    with pytest.raises(LinkError, match="refuses instruction 0x02: access error 7"):
        ask(bench, 1, codec.encode_status(1, 7))
