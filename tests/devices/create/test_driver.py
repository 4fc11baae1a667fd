import math
from dataclasses import replace

import numpy as np
import pytest
from kinematic import CREATE2 as KINEMATIC
from kinematic import JumpingClock, KinematicBase, turned

from scan3d_twin.core.errors import ConfigError, HazardError, LinkError, LinkTimeoutError
from scan3d_twin.core.navigation.wheel_kinematics import WHEEL_ACCELERATION
from scan3d_twin.core.types import Hazards, Pose2
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create import emulator
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, Op
from scan3d_twin.devices.create.driver import FAREWELL, open_create
from scan3d_twin.devices.create.driving import inquiry
from scan3d_twin.devices.create.emulation.body import Quirks
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.link import HALF_DRIVE, watched_packets
from scan3d_twin.devices.create.packets import Mode, Packet
from scan3d_twin.devices.links.line_model import NO_FAULTS, Faults, Line, Wire

pytestmark = pytest.mark.slow

SLICE = 0.005


class Recorded:
    """A guard that records its heartbeats."""

    def __init__(self):
        self.beats = []

    def beat(self, moving):
        self.beats.append(moving)


class Rig:
    """The real driver on an emulated base."""

    def __init__(self, model=CREATE2, faults=NO_FAULTS, before=b"", *, inert=False, **quirks):
        spec = replace(KINEMATIC, wheel_base=model.wheel_base_mm / 1000)
        self.base = KinematicBase(spec, WHEEL_ACCELERATION) if inert else KinematicBase()
        self.clock = JumpingClock(self.base)
        self.device = CreateEmulator(self.base, model, Quirks(**quirks))
        self.line = Line(self.device, faults, seed=1)
        self.written = []
        self.guard = Recorded()
        self.before = before

    def open(self):
        if self.before:
            self.device.receive(self.before, self.clock.now())
        wire = Wire(self.line, self.clock)
        write = wire.write

        def spy(data):
            self.written.append((self.clock.now(), bytes(data)))
            write(data)

        wire.write = spy
        self.wire = wire
        self.driver = open_create(wire, self.clock, self.guard)
        return self

    def wait(self, seconds):
        end = self.clock.now() + seconds
        while self.clock.now() < end - 1e-9:
            self.clock.sleep(SLICE)
            self.driver.service(self.clock.now())

    @property
    def pose(self):
        return self.driver.odometry().T_odom_base


@pytest.fixture
def rig():
    return Rig().open()


# Finding it.


def at(baud):
    return oi.command(Op.START) + oi.command(Op.BAUD, oi.BAUD_CODES.index(baud))


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
@pytest.mark.parametrize("baud", [115200, 57600, 19200])
def test_model_and_speed_are_found(model, baud):
    rig = Rig(model, before=at(baud)).open()
    assert rig.driver.contact.model is model
    assert rig.driver.contact.baud == baud
    assert rig.driver.spec.name == model.name
    assert rig.clock.now() < 2.0


LEFT_OVER = {
    "off": b"",
    "driving in full": bytes([128, 132]) + oi.drive_direct(100, 100),
    "a foreign stream": bytes([128]) + oi.stream([7, 19, 20, 35]),
    "half a drive command": bytes([128, 131, 145, 0]),
    "half a song": bytes([128, 131, 140, 0, 2, 60]),
    "just reset": bytes([128, 7]),
}


@pytest.mark.parametrize("before", LEFT_OVER.values(), ids=LEFT_OVER)
def test_it_connects_from_any_state_and_stands(before):
    rig = Rig(before=before).open()
    assert rig.device.mode is Mode.PASSIVE
    assert rig.base.speed == (0.0, 0.0)
    assert rig.pose == Pose2()
    assert rig.clock.now() < 5.0


def test_opening_never_moves_the_robot(rig):
    assert rig.base.odometry().T_odom_base == Pose2()
    rig.wait(1.0)
    assert rig.base.odometry().T_odom_base == Pose2()
    assert all(data[0] != Op.DRIVE_DIRECT for _, data in rig.written)


@pytest.mark.parametrize("quirks", [{"header_summed": False}, {"mode_offset": 1}, {"deaf": 0.02}])
def test_firmware_quirks_are_coped_with(quirks):
    rig = Rig(**quirks).open()
    rig.driver.set_velocity(0.2, 0.0)
    assert rig.driver.mode is Mode.SAFE
    rig.wait(1.0)
    assert rig.pose.x == pytest.approx(0.2, abs=0.01)


def test_junk_in_the_port_is_survived():
    rig = Rig(faults=Faults(junk=b"bl-start\r\nSTR730\r\n" + bytes(range(256)))).open()
    assert rig.driver.contact.model is CREATE2


def test_nothing_there_is_said_with_a_cure():
    with pytest.raises(LinkTimeoutError, match=r"no Create answers .* switch it on"):
        Rig(silent=True).open()


def test_a_base_at_rest_does_not_fall_asleep(rig, monkeypatch):
    """In Passive a Create 2 sleeps after five minutes without a command; here in five seconds."""
    assert inquiry.KEEP_AWAKE < emulator.SLEEP_AFTER / 2
    monkeypatch.setattr(emulator, "SLEEP_AFTER", emulator.SLEEP_AFTER / 60)
    monkeypatch.setattr(inquiry, "KEEP_AWAKE", inquiry.KEEP_AWAKE / 60)
    rig.wait(12.0)
    assert not rig.device.asleep
    assert rig.driver.mode is Mode.PASSIVE


# Driving.


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
@pytest.mark.parametrize("baud", [115200, 57600, 19200])
@pytest.mark.parametrize("counts", [(0, 0), (65535, 65530)])
def test_driving_back_and_forth_is_known_to_the_millimetre(model, baud, counts):
    # Back across count 0, .60 m must not become +28 m.
    rig = Rig(model, before=at(baud), counts=counts).open()
    for speed in (-0.2, 0.2, 0.2, -0.2):
        rig.driver.set_velocity(speed, 0.0)
        rig.wait(3.0)
        rig.driver.set_velocity(0.0, 0.0)
        rig.wait(0.6)
        assert rig.pose.x == pytest.approx(rig.base.odometry().T_odom_base.x, abs=0.004)
    assert abs(rig.pose.yaw) < 1e-6


def test_the_counts_wrap_many_times():
    rig = Rig().open()
    rig.driver.set_velocity(0.5, 0.0)
    rig.wait(70.0)
    assert rig.pose.x == pytest.approx(35.0, abs=0.02)


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
@pytest.mark.parametrize("rate", [math.radians(3.6), math.radians(-5.0), math.radians(40.0)])
def test_a_slow_turn_is_not_lost(model, rate):
    # A Create 1 that is read every 15 ms says 0 here.
    rig = Rig(model).open()
    rig.driver.set_velocity(0.0, rate)
    rig.wait(10.0)
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.6)
    truth = turned(rig.base)
    assert abs(truth) > 0.5
    error = (rig.pose.yaw - truth + math.pi) % math.tau - math.pi
    assert abs(error) < math.radians(0.6)


def test_a_create_1_that_slips_is_corrected_to_the_degree():
    rig = Rig(CREATE1).open()
    rig.base.set_velocity = lambda v, w: KinematicBase.set_velocity(rig.base, v, 0.8 * w)
    rig.driver.set_velocity(0.0, 0.5)
    rig.wait(3.0)
    assert rig.pose.yaw == pytest.approx(1.5, abs=0.04)
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.6)
    assert rig.pose.yaw == pytest.approx(1.2, abs=math.radians(1.2))


def test_covariance_of_a_create_1_is_larger_while_it_only_knows_its_commands():
    rigs = [Rig(model).open() for model in (CREATE1, CREATE2)]
    for rig in rigs:
        rig.driver.set_velocity(0.0, 0.5)
        rig.wait(2.0)
    first, second = (rig.driver.odometry().covariance[2, 2] for rig in rigs)
    assert first > second > 0
    rigs[0].driver.set_velocity(0.0, 0.0)
    rigs[0].wait(0.6)
    assert second < rigs[0].driver.odometry().covariance[2, 2] < first


def test_one_write_per_command_and_rest_after_a_change_of_mode(rig):
    rig.written.clear()
    rig.driver.set_velocity(0.1, 0.0)
    (safe_at, safe), (drive_at, drive) = rig.written
    assert safe == bytes([131])
    assert drive == bytes([145, 0, 100, 0, 100])
    assert drive_at - safe_at >= 0.02


@pytest.mark.parametrize("side", [-1, 1])
def test_a_turn_about_one_wheel_is_made_ready_for_too(rig, side):
    rig.driver.set_velocity(0.05, side * 0.1 / 0.235)
    rig.wait(0.2)
    assert rig.device.mode is Mode.SAFE
    assert sorted(rig.device.wheels_mm) == [0, 100]


def test_a_command_is_given_time_to_be_understood_before_it_is_repeated(rig):
    rig.driver.set_velocity(0.1, 0.0)
    rig.wait(0.2)
    rig.written.clear()
    rig.device.receive(oi.drive_direct(100, 228), rig.clock.now())
    rig.wait(0.2)
    assert [data[0] for _, data in rig.written] == [Op.DRIVE_DIRECT]
    rig.driver.set_velocity(0.2, 0.0)
    rig.written.clear()
    rig.wait(0.5)
    assert rig.written == []


def test_the_odometry_begins_where_the_robot_stood_when_it_was_opened(rig):
    rig.wait(0.1)
    first, second, *_ = rig.driver.odometry_since(-1.0)
    assert first.T_odom_base == Pose2()
    assert rig.driver.odometry_since(first.stamp)[0] == first
    assert rig.driver.odometry_since((first.stamp + second.stamp) / 2)[0] == first
    assert rig.driver.odometry_since(second.stamp)[0] == second


def test_the_guard_is_told_of_no_motion_before_there_is_one(rig):
    rig.wait(0.3)
    assert rig.guard.beats
    assert not any(rig.guard.beats)


def hears_a_change_to_300_baud(rig):
    """Let the base of ``rig`` take a garbled byte for the command for 300 bit/s."""
    rig.device.receive(oi.command(Op.BAUD, 0), rig.clock.now())


@pytest.mark.parametrize("model", [CREATE1, CREATE2])
def test_a_driving_base_that_was_sent_to_300_baud_stops_and_drives_on(model, caplog):
    rig = Rig(model).open()
    rig.driver.set_velocity(0.1, 0.0)
    rig.wait(0.5)
    hears_a_change_to_300_baud(rig)
    rig.wait(0.8)
    assert rig.device.wheels_mm == (0, 0)
    rig.wait(1.5)
    assert "the base has not answered for 0.3" in caplog.text
    assert rig.driver.odometry().stamp > rig.clock.now() - 0.2
    assert rig.device.wheels_mm == (100, 100)


def test_a_standing_base_is_found_again_at_300_baud(rig):
    hears_a_change_to_300_baud(rig)
    rig.wait(2.9)
    assert rig.driver.odometry().stamp > rig.clock.now() - 0.2


@pytest.mark.parametrize("model", [CREATE1, CREATE2])
def test_it_connects_to_a_base_that_listens_at_300_baud(model):
    rig = Rig(model, before=at(300)).open()
    assert rig.driver.contact.model is model


def test_a_silent_base_is_asked_now_and_then_only(rig):
    rig.line.faults = Faults(drop=1.0)
    rig.written.clear()
    with pytest.raises(LinkError):
        rig.wait(5.0)
    asked = [stamp for stamp, data in rig.written if bytes([Op.STREAM]) in data]
    assert 4 < len(asked) <= 31
    assert min(np.diff(asked)) > 0.09


def test_speeds_are_whole_mm_per_s_and_said_truly(rig):
    linear, angular = rig.driver.set_velocity(0.1004, 0.3)
    assert rig.base.speed == (0.0, 0.0)
    rig.wait(0.02)
    assert rig.base.speed == pytest.approx((linear, angular), abs=1e-9)
    assert linear == pytest.approx(0.1005, abs=1e-9)


def test_too_fast_keeps_the_path_and_no_number_is_refused(rig):
    linear, angular = rig.driver.set_velocity(2.0, 4.0)
    assert abs(linear) + abs(angular) * 0.235 / 2 == pytest.approx(0.5, abs=0.001)
    assert angular / linear == pytest.approx(2.0, rel=0.02)
    with pytest.raises(ConfigError, match="finite"):
        rig.driver.set_velocity(math.nan, 0.0)


def test_stamps_are_in_order_and_near_the_truth(rig):
    rig.driver.set_velocity(0.0, 0.3)
    rig.wait(3.0)
    samples = rig.driver.odometry_since(0.0)
    stamps = np.array([sample.stamp for sample in samples])
    assert (np.diff(stamps) > 0).all()
    assert 0 <= rig.clock.now() - stamps[-1] <= 0.03
    late = samples[-100:]
    yaw = np.interp(
        [s.stamp for s in late],
        [s.stamp for s in rig.base.odometry_since(0.0)],
        np.unwrap([s.T_odom_base.yaw for s in rig.base.odometry_since(0.0)]),
    )
    error = np.abs(yaw - [s.T_odom_base.yaw for s in late])
    assert error.max() < 0.3 * 0.006 + math.radians(0.11)


# Safety.

HAZARDS = {
    "bump left": Hazards(bump_left=True),
    "bump right": Hazards(bump_right=True),
    "cliff left": Hazards(cliff_left=True),
    "cliff front left": Hazards(cliff_front_left=True),
    "cliff front right": Hazards(cliff_front_right=True),
    "cliff right": Hazards(cliff_right=True),
    "wheel drop left": Hazards(wheel_drop_left=True),
    "wheel drop right": Hazards(wheel_drop_right=True),
    "overcurrent left": Hazards(overcurrent_left=True),
    "overcurrent right": Hazards(overcurrent_right=True),
    "low battery": Hazards(battery=0.05),
}


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
@pytest.mark.parametrize("name", HAZARDS)
def test_a_hazard_stops_within_50_ms_and_is_named(model, name):
    rig = Rig(model).open()
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.base.hazard = HAZARDS[name]
    before = rig.clock.now()
    with pytest.raises(HazardError, match=f"stopped: {name}"):
        rig.wait(1.0)
    assert rig.clock.now() - before <= 0.05
    rig.clock.sleep(SLICE)
    rig.wire.read(0.0)
    assert rig.base.speed == (0.0, 0.0)
    assert rig.guard.beats[-1] is False


def test_driving_on_into_a_hazard_raises_again_and_backing_off_does_not(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.base.hazard = HAZARDS["bump left"]
    with pytest.raises(HazardError, match="bump left"):
        rig.wait(1.0)
    rig.driver.set_velocity(-0.1, 0.0)
    rig.wait(0.5)
    rig.driver.set_velocity(0.1, 0.0)
    with pytest.raises(HazardError, match="bump left"):
        rig.wait(1.0)


def test_after_a_cliff_it_backs_off_in_safe_mode_again(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.base.hazard = HAZARDS["cliff left"]
    with pytest.raises(HazardError):
        rig.wait(1.0)
    assert rig.device.mode is Mode.PASSIVE
    rig.driver.set_velocity(-0.1, 0.0)
    rig.wait(0.5)
    assert rig.device.mode is Mode.SAFE
    assert rig.base.speed == (-0.1, 0.0)


def test_on_the_charger_or_with_an_empty_battery_it_does_not_drive_off(rig):
    rig.base.hazard = Hazards(battery=0.05)
    rig.wait(0.1)
    with pytest.raises(HazardError, match=r"low battery: 5% left; charge"):
        rig.driver.set_velocity(0.1, 0.0)
    rig.base.hazard = Hazards()
    rig.device.body.charger = 2
    rig.wait(0.1)
    with pytest.raises(HazardError, match="charger: unplug"):
        rig.driver.set_velocity(0.1, 0.0)
    assert rig.device.mode is Mode.PASSIVE


def test_plugging_in_the_charger_while_driving_is_said(rig):
    rig.driver.set_velocity(0.1, 0.0)
    rig.wait(0.2)
    rig.device.body.charger = 1
    with pytest.raises(HazardError, match="charger was plugged in"):
        rig.wait(1.0)


@pytest.mark.parametrize("latency", [0.15, 0.3])
def test_a_line_or_a_computer_that_is_slow_is_no_refusal_to_drive(latency):
    rig = Rig().open()
    rig.line.latency = latency
    rig.wait(0.5)
    rig.driver.set_velocity(0.1, 0.0)
    assert rig.driver.mode is Mode.SAFE
    rig.wait(0.1)
    assert rig.base.speed == (0.1, 0.0)


def test_a_program_that_wakes_up_late_sees_the_answer_all_the_same(rig):
    sleep = rig.clock.sleep
    rig.clock.sleep = lambda seconds: sleep(max(seconds, 0.15))
    rig.driver.set_velocity(0.1, 0.0)
    assert rig.driver.mode is Mode.SAFE


def test_hanging_wheels_keep_it_from_driving_off(rig):
    rig.base.hazard = HAZARDS["wheel drop left"]
    with pytest.raises(HazardError):
        rig.wait(0.1)
    with pytest.raises(HazardError, match="wheel drop left"):
        rig.driver.set_velocity(0.1, 0.0)
    assert rig.base.speed == (0.0, 0.0)


def test_opening_with_hanging_wheels_tells_and_does_not_raise():
    rig = Rig()
    rig.base.hazard = HAZARDS["wheel drop left"]
    assert rig.open().driver.hazards().active() == ("wheel drop left",)


def test_a_base_that_falls_silent_is_told_to_stop(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.line.faults = Faults(stalls=1e6, stall=60.0)
    before = rig.clock.now()
    with pytest.raises(HazardError, match=r"stopped: the base has been silent for 1\.0 s"):
        rig.wait(2.0)
    assert rig.clock.now() - before < 1.1
    stops = [stamp for stamp, data in rig.written if data == oi.drive_direct(0, 0)]
    assert 0.29 < stops[0] - before < 0.35
    assert rig.written[-1][1] == oi.drive_direct(0, 0)
    rig.clock.sleep(SLICE)
    rig.line._push(rig.clock.now())
    assert rig.base.speed == (0.0, 0.0)


def test_a_base_that_sends_garbage_only_is_given_up_when_a_frame_at_300_baud_would_have_ended(rig):
    """Bytes are a sign of life: it may be sending what it had begun before it was called back."""
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    read, ends = rig.wire.read, rig.clock.now() + 60.0
    rig.wire.read = lambda timeout: b"\0" * len(read(timeout)) * (rig.clock.now() < ends)
    with pytest.raises(HazardError, match=r"stopped: the base has been silent for 2\.5 s"):
        rig.wait(4.0)

    # Once the line is dead, too, it is not waited for any longer
    rig.wire.read = read
    rig.wait(1.0)
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.wire.read = lambda timeout: b"\0" * len(read(timeout)) * (rig.clock.now() < ends)
    ends = rig.clock.now() + 0.7
    with pytest.raises(HazardError, match=r"stopped: the base has been silent for 1\.7 s"):
        rig.wait(4.0)


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
def test_a_base_that_is_silent_for_a_moment_stands_and_drives_on(model):
    rig = Rig(model, inert=True).open()
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.line.faults = Faults(stalls=1e6, stall=0.7)
    rig.wait(0.05)
    rig.line.faults = NO_FAULTS
    stood = []
    for _ in range(20):
        rig.wait(0.05)
        stood.append(rig.base.wheels == (0.0, 0.0))
    assert any(stood)
    assert rig.base.wheels == pytest.approx((0.2, 0.2))
    assert rig.pose.distance(rig.base.odometry().T_odom_base) < 0.02


@pytest.mark.parametrize("seconds", [0.4, 5.0])
def test_after_a_hang_in_which_the_guard_stopped_it_the_base_drives_on(rig, seconds):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.clock.sleep(0.3)
    rig.device.receive(HALF_DRIVE + FAREWELL, rig.clock.now())
    rig.clock.sleep(seconds - 0.3)
    assert (rig.device.mode, rig.base.speed) == (Mode.PASSIVE, (0.0, 0.0))
    rig.wait(0.5)
    assert (rig.device.mode, rig.base.speed) == (Mode.SAFE, (0.2, 0.0))
    assert rig.pose.distance(rig.base.odometry().T_odom_base) < 0.02


def test_a_create_1_knows_that_the_guard_stopped_it_in_a_hang():
    rig = Rig(CREATE1).open()
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.clock.sleep(0.3)
    rig.device.receive(HALF_DRIVE + FAREWELL, rig.clock.now())
    rig.clock.sleep(4.7)
    rig.wait(0.3)
    # Without its encoders, and 4.7 s at 0.2 m/s would be 0.94 m.
    assert rig.pose.distance(rig.base.odometry().T_odom_base) < 0.03


def test_after_a_long_hang_the_base_does_not_drive_on(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.clock.sleep(0.3)
    rig.device.receive(HALF_DRIVE + FAREWELL, rig.clock.now())
    rig.clock.sleep(9.8)
    with pytest.raises(HazardError, match=r"hung for 10\.1 s"):
        rig.wait(0.1)
    rig.clock.sleep(SLICE)
    rig.line._push(rig.clock.now())
    assert rig.base.speed == (0.0, 0.0)
    rig.wait(0.5)
    assert rig.base.speed == (0.0, 0.0)


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
@pytest.mark.parametrize("baud", [115200, 19200])
@pytest.mark.parametrize("seconds", [0.4, 8.5])
def test_a_drive_after_planning_begins_without_a_halt(model, baud, seconds, caplog):
    rig = Rig(model, inert=True, before=at(baud)).open()
    for _ in range(2):
        rig.driver.set_velocity(0.2, 0.0)
        rig.wait(0.5)
        rig.driver.set_velocity(0.0, 0.0)
        rig.wait(0.5)
        rig.written.clear()
        rig.clock.sleep(seconds)
        started = rig.clock.now()
        rig.driver.set_velocity(0.2, 0.0)
        # The latest reading tells of the moment, not of that before the planning
        assert rig.driver.odometry().stamp > started - 0.1
        assert rig.clock.now() - started < 0.3
        rig.wait(0.5)
        assert rig.base.wheels == pytest.approx((0.2, 0.2))
    assert not caplog.messages
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.6)
    assert rig.pose.distance(rig.base.odometry().T_odom_base) < 0.02


def test_a_robot_that_was_lifted_while_the_program_planned_does_not_start(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.5)
    rig.base.hazard = HAZARDS["wheel drop right"]
    rig.clock.sleep(8.5)
    with pytest.raises(HazardError, match="wheel drop right"):
        rig.driver.set_velocity(0.2, 0.0)
    assert rig.base.speed == (0.0, 0.0)


@pytest.mark.parametrize(
    ("stall", "hang", "words"), [(0.6, 0.0, "has not answered"), (0.0, 0.5, "computer was busy")]
)
def test_a_halt_says_whether_the_cable_or_the_computer_is_to_blame(rig, stall, hang, words, caplog):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.line.faults = Faults(stalls=1e6 if stall else 0.0, stall=stall)
    rig.wait(0.05)
    rig.line.faults = NO_FAULTS
    rig.clock.sleep(hang)
    rig.wait(1.0)
    (message,) = caplog.messages
    assert message.startswith("halted")
    assert words in message


def test_after_a_hang_a_hazard_is_still_one(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.base.hazard = HAZARDS["wheel drop right"]
    rig.clock.sleep(0.4)
    with pytest.raises(HazardError, match="wheel drop right"):
        rig.wait(0.2)
    assert rig.base.speed == (0.0, 0.0)


def test_a_base_that_leaves_safe_mode_without_a_hang_is_an_error(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.device.receive(oi.command(Op.START), rig.clock.now())
    with pytest.raises(HazardError, match="left Safe mode"):
        rig.wait(0.2)


def test_a_base_that_is_silent_while_it_stands_is_an_error_of_the_link(rig):
    rig.line.faults = Faults(stalls=1e6, stall=60.0)
    with pytest.raises(LinkError, match=r"silent for 3\.0 s") as caught:
        rig.wait(5.0)
    # Not one that a sweep takes for a lidar that is late.
    assert not isinstance(caught.value, LinkTimeoutError)


def test_at_rest_the_stream_is_asked_for_again(rig):
    rig.device.receive(oi.command(Op.STOP), rig.clock.now())
    rig.wait(1.0)
    assert rig.clock.now() - rig.driver.odometry().stamp < 0.03


def test_a_base_left_alone_for_long_is_taken_up_again(rig):
    rig.clock.sleep(60.0)
    rig.wait(0.1)
    assert rig.clock.now() - rig.driver.odometry().stamp < 0.03


def test_a_garbled_drive_command_is_repeated(rig):
    rig.driver.set_velocity(0.1, 0.0)
    rig.wait(0.2)
    rig.device.receive(oi.drive_direct(100, 228), rig.clock.now())
    rig.wait(0.2)
    assert rig.base.speed == (0.1, 0.0)
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.2)
    rig.device.receive(oi.drive_direct(0, 128), rig.clock.now())
    rig.wait(0.2)
    assert rig.base.speed == (0.0, 0.0)


def test_a_base_that_was_switched_off_and_on_keeps_its_pose(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(2.0)
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.3)
    before = rig.pose
    rig.device.body.wheels._left_mm += 9000.0
    rig.wait(1.0)
    assert rig.pose == before


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
def test_closing_stops_silences_and_leaves_passive(model):
    rig = Rig(model).open()
    rig.driver.set_velocity(0.2, 0.1)
    rig.wait(0.5)
    rig.driver.close()
    rig.clock.sleep(0.05)
    rig.wire.read(0.0)
    assert rig.base.speed == (0.0, 0.0)
    assert rig.device.mode is Mode.PASSIVE
    rig.wire.read(0.05)
    assert rig.wire.read(0.2) == b""
    assert rig.guard.beats[-1] is False


def test_an_unplugged_port_does_not_keep_closing_from_ending(rig):
    rig.line.plugged = False
    rig.driver.close()
    assert rig.guard.beats[-1] is False


def test_the_guard_hears_of_every_step(rig):
    rig.guard.beats.clear()
    rig.wait(0.1)
    assert not any(rig.guard.beats)
    rig.driver.set_velocity(0.1, 0.0)
    rig.guard.beats.clear()
    rig.wait(1.0)
    assert all(rig.guard.beats)
    assert len(rig.guard.beats) > 100


# A bad line.


@pytest.mark.parametrize(
    "faults", [Faults(flip=0.002), Faults(drop=0.002), Faults(insert=0.002)], ids=str
)
def test_a_bad_line_never_gives_a_wrong_pose(rig, faults):
    rig.line.faults = faults
    for k in range(20):
        try:
            rig.driver.set_velocity((-1) ** k * 0.1, 0.0)
            rig.wait(1.0)
            rig.driver.set_velocity(0.0, 0.0)
        except (HazardError, LinkError):
            rig.line.faults = Faults()
            rig.wait(0.3)
            rig.line.faults = faults
        truth = {round(s.stamp, 3): s.T_odom_base for s in rig.base.odometry_since(0.0)}
        assert rig.pose.distance(truth[max(truth)]) < 0.05
    rig.line.faults = Faults()
    rig.driver.set_velocity(0.0, 0.0)
    rig.wait(0.3)
    assert rig.pose.distance(rig.base.odometry().T_odom_base) < 0.002


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
def test_odometry_is_back_within_300_ms_of_the_line(model):
    rig = Rig(model).open()
    read, rng = rig.wire.read, np.random.default_rng(4)
    rig.wire.read = lambda timeout: rng.bytes(len(read(timeout)))
    rig.wait(1.0)
    rig.wire.read = read
    rig.wait(0.3)
    assert rig.clock.now() - rig.driver.odometry().stamp < 0.03


def test_the_packets_asked_for_fit_the_line(rig):
    # The questions for its mode and its model are shorter.
    (request,) = (d for _, d in rig.written if d[0] == Op.STREAM and len(d) > 5)
    packets = list(request[2:])
    assert oi.fits_stream(packets, 115200)
    assert Packet.LEFT_COUNTS in packets
    slow = Rig(before=at(19200)).open()
    assert slow.driver.spec.sample_period == 0.03
    assert any(d[0] == Op.QUERY_LIST for _, d in slow.written)


def test_a_create_1_that_is_turned_by_hand_notices(rig):
    rig = Rig(CREATE1).open()
    rig.wait(0.5)
    rig.base.speed = (0.0, math.radians(400.0))
    rig.wait(0.15)
    rig.base.speed = (0.0, 0.0)
    rig.wait(0.1)
    assert rig.pose.yaw == pytest.approx(turned(rig.base), abs=math.radians(12.0))
    assert abs(rig.pose.yaw) > 0.7


def corrupted(data, rng, share=0.01):
    """Flip, drop and insert about that share of the bytes each."""
    out = bytearray()
    for byte, (flip, drop, insert) in zip(data, rng.random((len(data), 3)).tolist(), strict=True):
        if drop > share:
            out.append(byte ^ (1 << int(8 * flip / share)) if flip < share else byte)
        if insert < share:
            out.append(int(256 * insert / share))
    return bytes(out)


NAMES = ["create1", "create2"]
COMMANDS = ((0.2, 0.0), (-0.2, 0.0), (0.05, 0.6), (0.05, -0.6))


@pytest.mark.parametrize(("model", "limit"), [(CREATE1, math.inf), (CREATE2, 0.03)], ids=NAMES)
def test_a_million_corrupted_bytes(model, limit):
    """Nothing but our own errors, never a jump, and never a position that the base was not at.

    A Create 1 is where its commands lead, which drifts with or without corrupted bytes.
    """
    rig = Rig(model, inert=True).open()
    read, rng, passed = rig.wire.read, np.random.default_rng(5), 0

    def worse(timeout):
        nonlocal passed
        data = corrupted(read(timeout), rng)
        passed += len(data)
        return data

    rig.wire.read = worse
    before, k, told = rig.driver.odometry(), 0, []
    while passed < 1_000_000:
        k += 1
        try:
            rig.driver.set_velocity(*COMMANDS[k % 4])
            for _ in range(100):
                rig.clock.sleep(0.03)
                rig.driver.service(rig.clock.now())
                place = rig.driver.odometry()
                way = place.T_odom_base.distance(before.T_odom_base)
                assert way < 0.25 * (place.stamp - before.stamp) + 0.01
                before = place
                (near, *_) = rig.base.odometry_since(place.stamp)
                assert place.T_odom_base.distance(near.T_odom_base) < limit
        except HazardError as error:
            told.append(str(error))
            rig.driver.set_velocity(0.0, 0.0)
            rig.clock.sleep(0.5)
    assert rig.driver.bad > 100
    assert len(told) <= 15
    assert all("silent" in words for words in told)


def test_on_a_bad_line_a_hazard_is_believed_when_it_is_read_twice(rig):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.2)
    rig.line._arrived += bytes(range(100))
    rig.wait(0.1)
    bump = oi.encode_frame(
        list(watched_packets(rig.driver.contact)), bumped(rig), header_summed=True
    )
    rig.line._arrived += bump
    rig.wait(0.1)
    assert not rig.driver.hazards().active()
    rig.base.hazard = HAZARDS["bump right"]
    before = rig.clock.now()
    with pytest.raises(HazardError, match="bump right"):
        rig.wait(0.2)
    assert rig.clock.now() - before < 0.05


def bumped(rig):
    """Return what the base reads now, and a bump."""
    return rig.driver._readings.values | {Packet.BUMPS_DROPS: 2}


def test_a_wheel_that_is_blocked_is_where_its_counts_say(rig):
    rig.driver.set_velocity(0.3, 0.0)
    rig.wait(0.3)
    rig.base.speed = (0.0, 0.0)
    rig.wait(0.5)
    assert rig.pose.distance(rig.base.odometry().T_odom_base) < 0.001
    stamps = [sample.stamp for sample in rig.driver.odometry_since(rig.clock.now() - 0.4)]
    assert max(np.diff(stamps)) < 0.02


# A drive command that swallows those after it.


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
@pytest.mark.parametrize(
    "swallows", [bytes([140, 0, 255]), bytes([148, 120])], ids=["song", "stream"]
)
@pytest.mark.parametrize("period", [0.03, 10.0])
def test_a_base_that_takes_drive_commands_for_something_else_is_freed(model, swallows, period):
    rig = Rig(model).open()
    rig.driver.set_velocity(0.0, 0.3)
    rig.wait(0.5)
    # A garbled command makes it run away, and wait for hundreds of bytes
    rig.device.receive(oi.drive_direct(400, -100) + swallows, rig.clock.now())
    began = rig.clock.now()
    while rig.clock.now() < began + 0.6:
        if period < 1.0:
            rig.driver.set_velocity(0.0, 0.3 + 0.02 * (rig.clock.now() - began))
        rig.wait(min(period, 0.6))
    assert rig.base.speed == pytest.approx((0.0, 0.31), abs=0.02)


@pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)
def test_a_garbled_command_that_ends_safe_mode_is_made_good_on_a_noisy_line_only(model, caplog):
    rig = Rig(model).open()
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    rig.driver._readings.filter.is_noisy = lambda now: True
    rig.device.receive(oi.command(Op.START), rig.clock.now())
    rig.wait(0.5)
    assert (rig.driver.mode, rig.base.speed) == (Mode.SAFE, (0.2, 0.0))
    assert caplog.messages == [
        "halted for a moment: a garbled command took the base out of Safe mode"
    ]

    # A base that does not return to Safe mode is no longer driven
    receive = rig.device.receive
    rig.wait(1.0)
    rig.device.receive = lambda data, now: receive(data.replace(bytes([Op.SAFE]), b""), now)
    receive(oi.command(Op.START), rig.clock.now())
    with pytest.raises(HazardError, match="left Safe mode"):
        rig.wait(3.0)
    assert rig.base.speed == (0.0, 0.0)


# Readings out of range.


def test_a_reading_out_of_range_is_left_out_and_said(rig, caplog):
    take = rig.driver._inquiry.source.take
    odd = {Packet.BUMPS_DROPS: 0x60, Packet.CHARGING_SOURCES: 8, Packet.MODE: 32}

    def take_odd(data, now):
        return [{**values, **odd} for values in take(data, now)]

    rig.driver._inquiry.source.take = take_odd
    rig.wait(4.0)
    assert rig.driver.mode is Mode.PASSIVE
    assert not rig.driver.hazards().active()
    assert not rig.driver.charging
    assert rig.driver._readings.filter.masked > 600
    assert len(caplog.messages) == 3
    assert "96 in packet 7 (bumps drops), which is out of range" in caplog.messages[0]
    odd[Packet.BUMPS_DROPS] = 0x61
    with pytest.raises(HazardError, match="bump right"):
        rig.wait(0.1)


def test_a_base_none_of_whose_readings_is_usable_is_not_called_silent(rig):
    source = rig.driver._inquiry.source
    take, rng = source.take, np.random.default_rng(0)
    rig.driver._readings.filter.is_noisy = lambda now: True
    source.take = lambda data, now: [
        {**values, Packet.MODE: int(rng.integers(100, 255))} for values in take(data, now)
    ]
    rig.driver._inquiry.ask_anew = lambda: None
    with pytest.raises(
        LinkError, match=r"no reading .* usable for 3\.0 s \(a value is out of range"
    ):
        rig.wait(5.0)


def test_a_hang_between_two_heartbeats_is_noticed(rig, caplog):
    rig.driver.set_velocity(0.2, 0.0)
    rig.wait(0.5)
    read = rig.wire.read

    def read_late(timeout):
        rig.wire.read = read
        rig.clock.sleep(0.2)
        return read(timeout)

    rig.wire.read = read_late
    rig.driver.service(rig.clock.now())
    rig.clock.sleep(0.15)
    # Neither wait is long, but the guard has heard nothing for 0.355 s
    rig.wire.read = read_late
    rig.driver.service(rig.clock.now())
    rig.wait(0.1)
    (message,) = caplog.messages
    assert "this computer was busy for 0.35 s" in message
