import math

import pytest
from kinematic import JumpingClock, KinematicBase

from scan3d_twin.core.types import Hazards
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, Op
from scan3d_twin.devices.create.emulation.body import Quirks
from scan3d_twin.devices.create.emulator import BANNER, CreateEmulator
from scan3d_twin.devices.create.packets import Mode, Packet, decode_packets

FORWARD = oi.drive_direct(200, 200)


class Bench:
    """An emulated base on the bench: send bytes, let time pass, receive."""

    def __init__(self, model=CREATE2, **quirks):
        self.base = KinematicBase()
        self.clock = JumpingClock(self.base)
        self.device = CreateEmulator(self.base, model, Quirks(**quirks))

    def say(self, *parts):
        data = b"".join(oi.command(p) if isinstance(p, Op) else bytes(p) for p in parts)
        self.device.receive(data, self.clock.now())

    def wait(self, seconds):
        for _ in range(round(seconds / 0.015)):
            self.clock.sleep(0.015)
            self.device.transmit(self.clock.now())

    def hear(self, seconds=0.0):
        self.clock.sleep(seconds)
        heard = b""
        while data := self.device.transmit(self.clock.now()):
            heard += data
        return heard

    def ask(self, *packets):
        self.hear()
        self.say(oi.query(packets))
        values = decode_packets(packets, self.hear())
        return values[packets[0]] if len(packets) == 1 else values


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def create1():
    return Bench(CREATE1)


def test_off_it_obeys_start_only(bench):
    bench.say(Op.FULL, Op.SAFE, oi.sensors(35))
    assert bench.device.mode is Mode.OFF
    assert bench.hear(0.1) == b""
    bench.say(Op.START)
    assert bench.device.mode is Mode.PASSIVE
    assert bench.ask(Packet.MODE) == 1


@pytest.mark.parametrize(
    ("op", "mode"),
    [(Op.CONTROL, Mode.SAFE), (Op.SAFE, Mode.SAFE), (Op.FULL, Mode.FULL), (Op.STOP, Mode.OFF)]
    + [(op, Mode.PASSIVE) for op in (Op.START, Op.SPOT, Op.CLEAN, Op.DEMO, Op.DOCK, Op.POWER)],
)
def test_modes(bench, op, mode):
    bench.say(Op.START, Op.FULL, op)
    assert bench.device.mode is mode


def test_passive_does_not_drive(bench):
    bench.say(Op.START, FORWARD, oi.command(Op.LEDS, 4, 0, 255))
    assert bench.base.speed == (0.0, 0.0)
    assert bench.device.outputs.leds is None


def test_safe_drives_and_passive_stops(bench):
    bench.say(Op.START, Op.SAFE, FORWARD)
    assert bench.base.speed == (0.2, 0.0)
    bench.say(Op.START)
    assert bench.base.speed == (0.0, 0.0)


@pytest.mark.parametrize(
    ("command", "speed"),
    [
        (oi.drive_direct(100, -100), (0.0, 0.2 / 0.235)),
        (oi.drive_direct(-150, -50), (-0.1, -0.1 / 0.235)),
        (oi.drive(300, -32768), (0.3, 0.0)),
        (oi.drive(300, 32767), (0.3, 0.0)),
        (oi.drive(100, 1), (0.0, 0.2 / 0.235)),
        (oi.drive(100, -1), (0.0, -0.2 / 0.235)),
        (oi.drive(-200, 500), (-0.2, -0.4)),
        (oi.drive(500, 100), (0.206, 0.588 / 0.235)),
        (oi.command(Op.DRIVE_PWM, 0, 255, 0, 255), (0.5, 0.0)),
        (oi.command(Op.DRIVE_DIRECT, 0x7F, 0xFF, 0x7F, 0xFF), (0.5, 0.0)),
    ],
)
def test_drive_commands(bench, command, speed):
    bench.say(Op.START, Op.SAFE, command)
    assert bench.base.speed == pytest.approx(speed, abs=0.005)


def test_requested_speeds_are_those_of_the_command_of_their_kind(bench):
    """Packets 39 and 40 report Drive, 41 and 42 report Drive Direct; within +-500 mm/s."""
    bench.say(Op.START, Op.SAFE, oi.drive_direct(100, -50))
    packets = (Packet.REQUESTED_VELOCITY, Packet.REQUESTED_RADIUS)
    wheels = (Packet.REQUESTED_RIGHT, Packet.REQUESTED_LEFT)
    assert list(bench.ask(*packets, *wheels).values()) == [0, 0, 100, -50]
    bench.say(oi.drive(600, 100))
    assert list(bench.ask(*packets, *wheels).values()) == [500, 100, 100, -50]
    bench.say(oi.command(Op.DRIVE_DIRECT, 0x7F, 0xFF, 0x80, 0x00))
    assert list(bench.ask(*packets, *wheels).values()) == [500, 100, 500, -500]


def test_the_last_command_holds_for_ever(bench):
    bench.say(Op.START, Op.SAFE, FORWARD)
    bench.wait(60.0)
    assert bench.base.odometry().T_odom_base.x == pytest.approx(12.0, abs=0.01)


DROP = Hazards(wheel_drop_left=True)
CLIFF = Hazards(cliff_front_left=True)


@pytest.mark.parametrize(
    ("hazard", "command", "mode"),
    [
        (DROP, FORWARD, Mode.PASSIVE),
        (DROP, oi.drive_direct(0, 0), Mode.PASSIVE),
        (CLIFF, FORWARD, Mode.PASSIVE),
        (CLIFF, oi.drive_direct(-200, -200), Mode.SAFE),
        (CLIFF, oi.drive_direct(-200, -10), Mode.PASSIVE),
        (CLIFF, oi.drive_direct(0, 0), Mode.SAFE),
        (Hazards(bump_left=True), FORWARD, Mode.SAFE),
    ],
)
def test_what_ends_safe_mode(bench, hazard, command, mode):
    # Create Open Interface, page 6: a cliff while moving forward, or backward on a circle smaller
    # than the robot; a wheel drop; not a bump.
    bench.say(Op.START, Op.SAFE, command)
    bench.base.hazard = hazard
    bench.wait(0.03)
    assert bench.device.mode is mode
    if mode is Mode.PASSIVE:
        assert bench.base.speed == (0.0, 0.0)


def test_full_mode_has_no_safety(bench):
    bench.say(Op.START, Op.FULL, FORWARD)
    bench.base.hazard = DROP
    bench.wait(0.03)
    assert bench.device.mode is Mode.FULL
    assert bench.base.speed == (0.2, 0.0)


def test_the_charger_ends_safe_mode_and_keeps_it_out(bench):
    bench.say(Op.START, Op.SAFE, FORWARD)
    bench.device.body.charger = 1
    bench.wait(0.03)
    assert bench.device.mode is Mode.PASSIVE
    bench.say(Op.SAFE)
    assert bench.device.mode is Mode.PASSIVE
    assert bench.ask(Packet.CHARGING_SOURCES, Packet.CHARGING_STATE) == {34: 1, 21: 2}


def test_the_stream_comes_every_15_ms(bench):
    bench.say(Op.START, oi.stream([29, 13]))
    data = bench.hear(0.15)
    assert len(data) == 10 * 8
    assert data[:2] == bytes([19, 5])
    assert sum(data[:8]) & 0xFF == 0
    bench.say(oi.command(Op.PAUSE_RESUME, 0))
    assert bench.hear(0.15) == b""
    bench.say(oi.command(Op.PAUSE_RESUME, 1))
    assert len(bench.hear(0.15)) == 10 * 8


def test_a_stream_that_no_frame_can_hold_is_ignored(bench):
    """Its length is one byte; packets 100, 1 and 7 take 81, 11 and 2 bytes."""
    bench.say(Op.START, oi.stream([100] * 9), oi.stream([100, 100, 100, 1, 7]))
    assert bench.hear(0.1) == b""
    bench.say(oi.stream([100, 100, 100, 1]))
    assert len(bench.hear(0.015)) == 3 + 254


def test_the_checksum_of_the_create_manual_is_a_quirk():
    bench = Bench(CREATE1, header_summed=False)
    bench.say(Op.START, oi.stream([29, 13]))
    data = bench.hear(0.015)
    assert sum(data[1:8]) & 0xFF == 0


@pytest.mark.parametrize(
    ("group", "size"), {0: 26, 1: 10, 2: 6, 3: 10, 4: 14, 5: 12, 6: 52}.items()
)
def test_groups_of_both_models(group, size):
    for bench in (Bench(CREATE1), Bench(CREATE2)):
        bench.say(Op.START, oi.sensors(group))
        assert len(bench.hear()) == size


@pytest.mark.parametrize("packet", [43, 58, 100, 101])
def test_a_create_1_does_not_know_the_packets_of_a_create_2(create1, bench, packet):
    create1.say(Op.START, oi.sensors(packet))
    bench.say(Op.START, oi.sensors(packet))
    assert create1.hear() == b""
    assert bench.hear() != b""


def test_encoder_counts_wrap_both_ways():
    bench = Bench(counts=(65530, 3))
    bench.say(Op.START, Op.SAFE, oi.drive_direct(-100, 100))
    assert bench.ask(43, 44) == {43: 65530, 44: 3}
    bench.wait(0.06)
    turn = round(6 / CREATE2.mm_per_count)
    assert bench.ask(43, 44) == {43: (65530 + turn) & 0xFFFF, 44: 3 - turn + 65536}


def test_one_turn_of_the_wheels_is_508_8_counts(bench):
    bench.say(Op.START, Op.SAFE, oi.drive_direct(226, 226))
    bench.wait(1.005)
    assert bench.ask(43) == pytest.approx(508.8 * 226 * 1.005 / (math.pi * 72), abs=1)


def test_distance_and_angle_since_the_last_read(bench):
    bench.say(Op.START, Op.SAFE, oi.drive_direct(200, 200))
    bench.wait(1.5)
    assert bench.ask(19) == pytest.approx(300, abs=1)
    assert bench.ask(19) == 0
    bench.say(oi.drive_direct(100, -100))
    bench.wait(1.5)
    assert bench.ask(20) == pytest.approx(math.degrees(0.3 / 0.235), abs=1)


def test_read_often_a_slow_turn_is_nothing(bench):
    bench.say(Op.START, Op.SAFE, oi.drive_direct(10, -10), oi.stream([20]))
    data = b"".join(bench.hear(0.015) for _ in range(400))
    assert abs(math.degrees(bench.base.odometry().T_odom_base.yaw)) > 25
    assert sum(int.from_bytes(data[k + 3 : k + 5], "big") for k in range(0, len(data), 6)) == 0


def test_firmware_quirks_of_packets_19_and_20():
    bench = Bench(angle_gain=0.25, distance_unsigned=True, mode_offset=1, truncates=False)
    bench.say(Op.START, Op.SAFE, oi.drive_direct(-200, -200))
    bench.wait(1.5)
    assert bench.ask(19) == pytest.approx(300, abs=1)
    assert bench.ask(35) == 3
    bench.say(oi.drive_direct(100, -100))
    angles = [bench.ask(20)]
    for _ in range(100):
        bench.wait(0.015)
        angles.append(bench.ask(20))
    assert sum(angles) == pytest.approx(math.degrees(0.3 / 0.235) / 4, abs=1)


def test_distance_is_capped(bench):
    bench.say(Op.START, Op.FULL, oi.drive_direct(500, 500))
    bench.wait(70.0)
    assert bench.ask(19) == 32767


def test_hazards_are_felt(bench):
    bench.say(Op.START)
    bench.base.hazard = Hazards(
        bump_right=True, cliff_right=True, wheel_drop_left=True, overcurrent_left=True, battery=0.5
    )
    values = bench.ask(7, 9, 12, 14, 25, 26)
    assert values[7] == 1 + 8
    assert (values[9], values[12], values[14]) == (0, 1, 16)
    assert values[25] / values[26] == pytest.approx(0.5, abs=0.001)


def test_leds_songs_and_drivers(bench):
    bench.say(Op.START, Op.SAFE, oi.command(Op.LEDS, 8, 128, 255))
    bench.say(oi.command(Op.SONG, 2, 2, 60, 32, 64, 32), oi.command(Op.PLAY, 2))
    bench.say(oi.command(Op.LOW_SIDE_DRIVERS, 5), oi.command(Op.PWM_LOW_SIDE_DRIVERS, 1, 2, 3))
    assert bench.device.outputs.leds == bytes([8, 128, 255])
    assert bench.device.outputs.drivers == bytes([5])
    assert bench.device.outputs.pwm == bytes([1, 2, 3])
    assert bench.ask(36, 37) == {36: 2, 37: 1}
    bench.wait(1.1)
    assert bench.ask(37) == 0


def test_a_create_2_stores_five_songs_a_create_1_sixteen(bench, create1):
    for each in (bench, create1):
        each.say(Op.START, *(oi.command(Op.SONG, n, 1, 60, 64) for n in range(20)))
    assert sorted(bench.device.outputs.songs) == list(range(5))
    assert sorted(create1.device.outputs.songs) == list(range(16))


SQUARE = [137, 1, 44, 128, 0, 156, 1, 144, 137, 1, 44, 0, 1, 157, 0, 90, 153]


def test_the_script_of_the_manual_drives_40_cm(create1):
    # Create Open Interface, page 15.
    create1.say(Op.START, Op.SAFE)
    create1.say([152, 13, 137, 1, 44, 128, 0, 156, 1, 144, 137, 0, 0, 0, 0], Op.SHOW_SCRIPT)
    assert create1.hear() == bytes([13, 137, 1, 44, 128, 0, 156, 1, 144, 137, 0, 0, 0, 0])
    create1.say(Op.PLAY_SCRIPT)
    create1.wait(3.0)
    assert create1.base.odometry().T_odom_base.x == pytest.approx(0.40, abs=0.006)
    assert create1.base.speed == (0.0, 0.0)


def test_the_square_of_the_manual_never_ends_and_ignores_its_port(create1):
    create1.say(Op.START, Op.SAFE, [152, 17, *SQUARE], Op.PLAY_SCRIPT)
    create1.wait(1.0)
    create1.say(Op.START, oi.drive_direct(0, 0))
    assert create1.device.mode is Mode.SAFE
    create1.wait(30.0)
    assert create1.base.speed != (0.0, 0.0)
    poses = [sample.T_odom_base for sample in create1.base.odometry_since(0.0)]
    assert max(pose.x for pose in poses) < 0.6
    assert max(pose.y for pose in poses) > 0.3


def test_waits_for_time_and_events(create1):
    create1.say(Op.START, Op.SAFE)
    create1.say(oi.script(FORWARD + bytes([155, 10]) + oi.drive_direct(0, 0)), Op.PLAY_SCRIPT)
    create1.wait(2.0)
    assert create1.base.odometry().T_odom_base.x == pytest.approx(0.2, abs=0.004)
    create1.say(FORWARD + bytes([158, 5]))
    create1.wait(1.0)
    create1.say(Op.START)
    assert create1.device.mode is Mode.SAFE
    create1.base.hazard = Hazards(bump_left=True)
    create1.wait(0.03)
    create1.say(Op.START)
    assert create1.device.mode is Mode.PASSIVE


def test_a_negative_event_is_its_opposite(create1):
    create1.base.hazard = Hazards(bump_left=True)
    create1.say(Op.START, bytes([158, 251]))
    create1.wait(0.03)
    create1.say(Op.SAFE)
    assert create1.device.mode is Mode.PASSIVE
    create1.base.hazard = Hazards()
    create1.wait(0.03)
    create1.say(Op.SAFE)
    assert create1.device.mode is Mode.SAFE


def test_a_script_without_a_wait_does_not_hang(create1):
    create1.say(Op.START, Op.SAFE, oi.script(bytes([139, 8, 0, 0, 153])), Op.PLAY_SCRIPT)
    create1.wait(1.0)
    assert create1.device.outputs.leds == bytes([8, 0, 0])


def test_the_speed_is_changed_on_request(bench):
    assert bench.device.baud == 115200
    assert Bench(CREATE1).device.baud == 57600
    bench.say(Op.START, oi.command(Op.BAUD, 7))
    assert bench.device.baud == 19200
    bench.say(oi.command(Op.BAUD, 12))
    assert bench.device.baud == 19200


def test_a_reset_prints_a_text_and_comes_up_off(bench):
    bench.say(Op.START, Op.FULL, oi.command(Op.BAUD, 7), oi.stream([7]), FORWARD, Op.RESET)
    assert bench.base.speed == (0.0, 0.0)
    assert bench.device.baud == 115200
    bench.say(Op.START)
    assert bench.device.mode is Mode.OFF
    assert bench.hear(4.0) == BANNER.encode()
    bench.say(Op.START)
    assert bench.device.mode is Mode.PASSIVE
    assert bench.hear(0.1) == b""


def test_a_create_1_takes_a_reset_too_and_prints_nothing(create1):
    create1.say(Op.START, Op.FULL, oi.command(Op.BAUD, 7), FORWARD, Op.RESET)
    assert create1.base.speed == (0.0, 0.0)
    assert (create1.device.mode, create1.device.baud) == (Mode.OFF, 57600)
    assert create1.hear(4.0) == b""
    create1.say(Op.START)
    assert create1.device.mode is Mode.PASSIVE


def test_it_sleeps_after_five_minutes_in_passive(bench):
    bench.say(Op.START)
    bench.wait(299.0)
    assert bench.ask(35) == 1
    bench.wait(301.0)
    bench.say(Op.START)
    assert bench.device.asleep
    assert bench.hear() == b""
    bench.device.wake()
    bench.say(Op.START)
    assert bench.device.mode is Mode.PASSIVE


def test_it_does_not_sleep_in_safe(bench):
    bench.say(Op.START, Op.SAFE)
    bench.wait(400.0)
    assert bench.device.mode is Mode.SAFE


def test_bytes_right_after_a_change_of_mode_may_be_lost():
    bench = Bench(deaf=0.02)
    bench.say(Op.START, Op.SAFE)
    assert bench.device.mode is Mode.PASSIVE
    bench.clock.sleep(0.021)
    bench.say(Op.SAFE)
    assert bench.device.mode is Mode.SAFE


def test_a_frozen_base_says_nothing():
    bench = Bench(silent=True)
    bench.say(Op.START, oi.stream([7]))
    assert bench.hear(1.0) == b""


def test_a_lost_byte_turns_data_into_opcodes(bench):
    # Without its last byte, 145 0 200 0 200 swallows the next opcode; a driver must expect that.
    bench.say(Op.START, Op.SAFE, FORWARD[:-1])
    bench.say(oi.drive_direct(0, 0))
    assert bench.base.speed != (0.0, 0.0)
