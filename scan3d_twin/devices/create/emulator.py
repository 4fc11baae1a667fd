"""An emulated iRobot Create: it serves any ``DriveBase`` through the Open Interface.

Sources: iRobot Create Open Interface (2007, page numbers below are its own) and iRobot Create 2
Open Interface (2016). The simulated time is passed with each call; each new odometry sample of the
base triggers the firmware's 15 ms tick.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from scan3d_twin.core.hal import DriveBase
from scan3d_twin.core.types import Odometry
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Command, CommandParser, Model, Op
from scan3d_twin.devices.create.emulation.body import Body, Quirks
from scan3d_twin.devices.create.emulation.outputs import Outputs
from scan3d_twin.devices.create.emulation.script import Script
from scan3d_twin.devices.create.packets import Mode, Packet, encode_packets, packets_of, size_of
from scan3d_twin.devices.create.roomba import step_speed
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE

MAX_BACKLOG = 0.1
"""Time that what is to be sent may still take when another stream frame is begun [s]; assumption:
a base that was sent to a low baud rate keeps no more than the frame it had begun."""
STARTING_BUTTONS = 0b111
"""Bits of Clean, Spot and Dock in the command that presses buttons; manual of the Create 2."""
SLEEP_AFTER = 300.0
"""Time without a command in Off or Passive after which a Create 2 falls asleep [s]."""
BOOT = 3.0
"""Time from a reset until commands are received again [s]; assumption."""
BANNER = (
    "bl-start\r\nSTR730\r\nbootloader id: #x47175347 4C636FFF\r\n"
    "bootloader info rev: #xF000\r\n2007-05-14-1715-L\r\n"
    "Roomba by iRobot!\r\nstr730\r\n2012-03-22-1549-L\r\nbattery-current-zero 252\r\n"
)
"""Text that a Roomba with firmware 2012-03-22 prints at a reset; robotics.stackexchange 7121."""
COMMANDS_PER_TICK = 50
"""Script commands per tick, so that a script that never waits cannot hang the emulator;
assumption."""
ROUNDING = 1e-6
"""Difference below which two times are equal [s]."""

_ACTUATORS = {
    Op.DRIVE, Op.LOW_SIDE_DRIVERS, Op.LEDS, Op.PLAY, Op.PWM_LOW_SIDE_DRIVERS, Op.DRIVE_DIRECT,
    Op.DRIVE_PWM, Op.DIGITAL_OUTPUTS, Op.SEND_IR, Op.SCHEDULING_LEDS, Op.DIGIT_LEDS_RAW,
    Op.DIGIT_LEDS_ASCII,
}  # fmt: skip
"""Commands that are obeyed in Safe and Full only."""


class CreateEmulator:
    """A ``Device``: an iRobot Create whose wheels are those of a ``DriveBase``.

    Attributes:
        mode: Mode of the Open Interface; Off until a client sends Start.
        body: Its sensors; set charger, buttons and walls to simulate them.
        outputs: Its LEDs, songs and outputs.
        wheels_mm: Commanded wheel speeds (right, left) in force [mm/s].
        asleep: Whether it receives nothing until ``wake`` is called.
        began: See ``Device``.
    """

    def __init__(
        self, base: DriveBase, model: Model = oi.CREATE2, quirks: Quirks | None = None
    ) -> None:
        # Visible state
        quirks = Quirks() if quirks is None else quirks
        self.mode = Mode.OFF
        self.body = Body(base, model, quirks)
        self.outputs = Outputs()
        self.wheels_mm = (0, 0)
        self.asleep = False

        # Time and serial line
        self._base, self._model, self._quirks = base, model, quirks
        self._baud = model.baud
        self._parser = CommandParser(model)
        self._stamp = base.odometry().stamp
        self._now = self._heard = self._stamp
        self._out: deque[tuple[int, float, bytes]] = deque()
        self._sent_by = 0.0
        self.began = 0.0
        self._later: deque[tuple[float, bytes]] = deque()
        self._deaf_until = 0.0

        # Stream, script and drive commands
        self._stream: list[int] = []
        self._streaming = False
        self._script = Script(model, self.body)
        self._requested = self._requested_direct = (0, 0)
        self._actions = self._make_actions()

    @property
    def baud(self) -> int:
        """See ``Device.baud``."""
        return self._out[0][0] if self._out else self._baud

    def receive(self, data: bytes, now: float) -> None:
        """See ``Device.receive``."""
        self._advance(now)
        for byte in data:
            if not self._is_listening():
                self._parser.reset()
            elif self.mode is not Mode.OFF or byte in (Op.START, Op.RESET):
                for command in self._parser.feed(bytes([byte])):
                    self._heard = now
                    self._obey(command)

    def transmit(self, now: float) -> bytes:
        """See ``Device.transmit``."""
        self._advance(now)
        if self._quirks.silent:
            self._out.clear()
        if not self._out:
            return b""
        _, self.began, data = self._out.popleft()
        return data

    def _put(self, data: bytes, now: float) -> None:
        """Put ``data`` on the line at ``now`` [s]."""
        if data:
            self._out.append((self._baud, now, data))
            self._sent_by = max(self._sent_by, now) + len(data) * BITS_PER_BYTE / self._baud

    def wake(self) -> None:
        """Press the power button, or pulse the BRC line."""
        self.asleep = False
        self._heard = self._now

    def _is_listening(self) -> bool:
        is_deaf = self.asleep or self._script.is_busy or self._now < self._deaf_until
        return not (is_deaf or self._quirks.silent)

    def _advance(self, now: float) -> None:
        """Let time pass up to ``now`` [s]."""
        # Tick with each sample
        for sample in self._base.odometry_since(self._stamp):
            if self._stamp < sample.stamp <= now + ROUNDING:
                self._tick(sample)
        self._now = max(self._now, now)

        # Send delayed texts, run the script
        while self._later and self._later[0][0] <= now:
            due, text = self._later.popleft()
            self._put(text, due)
        self._run_script()

        # Fall asleep when idle
        idle = self.mode <= Mode.PASSIVE and not self.body.charger
        if idle and self._model.has_counts and now - self._heard > SLEEP_AFTER:
            self._change_mode(Mode.OFF)
            self.asleep = True

    def _tick(self, sample: Odometry) -> None:
        """Run the firmware's 15 ms cycle."""
        # Update wheels, mode and script
        self._stamp = self._now = sample.stamp
        self.body.wheels.take(sample)
        if self.mode is Mode.SAFE and self._must_leave_safe():
            self._change_mode(Mode.PASSIVE)
        self._run_script()

        # Send a stream frame, if the line is not too slow for them
        is_free = self._sent_by - self._now < MAX_BACKLOG
        if self._streaming and self.mode is not Mode.OFF and is_free:
            summed = self._quirks.header_summed
            frame = oi.encode_frame(self._stream, self._values(self._stream), header_summed=summed)
            self._put(frame, self._now)

    def _must_leave_safe(self) -> bool:
        """Return whether a sensor forces the base out of Safe mode; page 6."""
        right, left = self.wheels_mm
        ahead, turn = right + left > 0, abs(right - left)
        tight = turn > 0 and abs(right + left) / turn * self._model.wheel_base_mm / 2 < (
            1000 * self._base.spec.radius
        )
        falls = self.body.cliff() and (ahead or tight)
        return falls or self.body.dropped() or bool(self.body.charger)

    # Commands.

    def _obey(self, command: Command) -> None:
        if command.op in _ACTUATORS and self.mode < Mode.SAFE:
            return
        self._actions[command.op](command)

    def _make_actions(self) -> dict[Op, Callable[[Command], None]]:
        passive = (Op.START, Op.POWER, Op.SPOT, Op.CLEAN, Op.DEMO, Op.DOCK)
        nothing = (Op.SCHEDULE, Op.SET_DAY_TIME, Op.SCHEDULING_LEDS)

        return {
            # Modes and the serial line
            **{op: lambda _: self._change_mode(Mode.PASSIVE) for op in passive},
            **{op: lambda _: None for op in nothing},
            Op.PUSH_BUTTONS: self._push_buttons,
            Op.RESET: self._reset,
            Op.BAUD: self._set_baud,
            Op.CONTROL: lambda _: self._change_mode(Mode.SAFE),
            Op.SAFE: lambda _: self._change_mode(Mode.SAFE),
            Op.FULL: lambda _: self._change_mode(Mode.FULL),
            Op.STOP: self._stop,
            # Wheels and outputs
            Op.DRIVE: self._drive,
            Op.DRIVE_DIRECT: self._drive_direct,
            Op.DRIVE_PWM: self._drive_pwm,
            **self._output_actions(),
            # Sensors
            Op.SENSORS: lambda c: self._send(c.data),
            Op.QUERY_LIST: lambda c: self._send(c.data[1:]),
            Op.STREAM: self._start_stream,
            Op.PAUSE_RESUME: self._pause_or_resume,
            # Scripts
            Op.SCRIPT: self._script.store,
            Op.PLAY_SCRIPT: lambda _: self._script.play(),
            Op.SHOW_SCRIPT: self._show_script,
            Op.WAIT_TIME: lambda c: self._script.wait_time(c, self._now),
            Op.WAIT_DISTANCE: self._script.wait_distance,
            Op.WAIT_ANGLE: self._script.wait_angle,
            Op.WAIT_EVENT: self._script.wait_event,
        }

    def _output_actions(self) -> dict[Op, Callable[[Command], None]]:
        outputs = self.outputs

        def show(name: str) -> Callable[[Command], None]:
            return lambda command: setattr(outputs, name, command.data)

        return {
            Op.LEDS: show("leds"),
            Op.LOW_SIDE_DRIVERS: show("drivers"),
            Op.PWM_LOW_SIDE_DRIVERS: show("pwm"),
            Op.DIGITAL_OUTPUTS: show("digital"),
            Op.DIGIT_LEDS_RAW: show("digits"),
            Op.DIGIT_LEDS_ASCII: show("digits"),
            Op.SEND_IR: show("sent_ir"),
            Op.SONG: lambda c: outputs.store_song(c.data, self._model.songs),
            Op.PLAY: lambda c: outputs.play_song(c.data[0], self._now),
        }

    def _change_mode(self, mode: Mode) -> None:
        """Enter ``mode``; page 6.

        Below Safe the wheels stop, and on entering Safe or Full the LEDs go out.
        """
        # Reset wheels or LEDs
        if mode <= Mode.PASSIVE:
            self._turn_wheels(0, 0)
            self.outputs.drivers = self.outputs.pwm = None
        elif self.mode <= Mode.PASSIVE:
            self.outputs.leds = None

        # Change the mode
        if mode is Mode.SAFE and self.body.charger:
            mode = Mode.PASSIVE
        self.mode = mode
        self._deaf_until = self._now + self._quirks.deaf

    def _stop(self, _: Command) -> None:
        self._streaming = False
        self._change_mode(Mode.OFF)

    def _push_buttons(self, command: Command) -> None:
        """Press buttons; Clean, Spot and Dock do what the commands of that name do."""
        self.outputs.buttons = command.data
        if command.data[0] & STARTING_BUTTONS:
            self._change_mode(Mode.PASSIVE)

    def _reset(self, _: Command) -> None:
        """Restart the firmware: mode Off, default baud rate, and a banner on the line.

        The manual of the Create 1 lacks this command, but drivers written for it have it
        (turtlebot_create, ``create_driver.py``). What it prints is unknown: nothing is.
        """
        self._stop(_)
        self._baud = self._model.baud
        self._stream, self._script.stored = [], b""
        self._deaf_until = self._now + BOOT
        if not self._model.has_counts:
            return
        lines = BANNER.encode().splitlines(keepends=True)
        self._later.append((self._now + 0.1, b"".join(lines[:3])))
        self._later.append((self._now + BOOT - 0.1, b"".join(lines[3:])))

    def _set_baud(self, command: Command) -> None:
        if command.data[0] < len(oi.BAUD_CODES):
            self._baud = oi.BAUD_CODES[command.data[0]]

    def _drive(self, command: Command) -> None:
        velocity, radius = self._requested = _clip(command.words()[0]), command.words()[1]
        if radius in oi.STRAIGHT:
            share = 0.0
        elif abs(radius) == 1:
            self._turn_wheels(radius * velocity, -radius * velocity)
            return
        else:
            share = self._model.wheel_base_mm / 2 / radius if radius else 0.0
        right, left = (_clip(round(velocity * side)) for side in (1 + share, 1 - share))
        self._turn_wheels(right, left)

    def _drive_direct(self, command: Command) -> None:
        right, left = self._requested_direct = _clip_both(command.words())
        self._turn_wheels(right, left)

    def _drive_pwm(self, command: Command) -> None:
        share = oi.MAX_WHEEL_SPEED_MM / 255
        right, left = (_clip(round(share * word)) for word in command.words())
        self._turn_wheels(right, left)

    def _turn_wheels(self, right_mm: int, left_mm: int) -> None:
        if max(abs(right_mm), abs(left_mm)) < self._model.min_speed_mm:
            right_mm = left_mm = 0
        if self._quirks.steps_speed:
            right_mm, left_mm = step_speed(right_mm), step_speed(left_mm)
        self.wheels_mm = (right_mm, left_mm)
        self._base.set_velocity(
            (right_mm + left_mm) / 2000, (right_mm - left_mm) / self._model.wheel_base_mm
        )

    # Sensors.

    def _values(self, numbers: Iterable[int]) -> dict[int, int]:
        """Return the readings of packets and groups; reading packets 19 and 20 resets them."""
        # Everything that reading does not change
        ids = {packet for number in numbers for packet in packets_of(number)}
        right, left = self._requested_direct
        values = {
            **self.body.readings(),
            Packet.MODE: self.mode + self._quirks.mode_offset,
            Packet.SONG_NUMBER: self.outputs.song,
            Packet.SONG_PLAYING: self._now < self.outputs.song_ends,
            Packet.STREAM_PACKETS: len(self._stream),
            Packet.REQUESTED_VELOCITY: self._requested[0],
            Packet.REQUESTED_RADIUS: self._requested[1],
            Packet.REQUESTED_RIGHT: right,
            Packet.REQUESTED_LEFT: left,
        }

        # Packets that reading resets
        if Packet.DISTANCE in ids:
            values[Packet.DISTANCE] = self.body.wheels.read_distance()
        if Packet.ANGLE in ids:
            values[Packet.ANGLE] = self.body.wheels.read_angle()
        return values

    def _send(self, numbers: bytes) -> None:
        """Send packets once; send nothing if one of them is unknown."""
        known = [n for n in numbers if n in self._model.packets and size_of(n)]
        if len(known) == len(numbers):
            self._put(encode_packets(known, self._values(known)), self._now)

    def _start_stream(self, command: Command) -> None:
        """Stream packets; ignore a request for an unknown one, or for more than a frame can hold.

        What the firmware does then is not documented; assumption.
        """
        known = [n for n in command.data[1:] if n in self._model.packets and size_of(n)]
        if len(known) == command.data[0] and oi.fits_frame(known):
            self._stream, self._streaming = known, bool(known)

    def _pause_or_resume(self, command: Command) -> None:
        self._streaming = bool(command.data[0]) and bool(self._stream)

    def _show_script(self, _: Command) -> None:
        self._streaming = False
        self._put(bytes([len(self._script.stored)]) + self._script.stored, self._now)

    def _run_script(self) -> None:
        """Continue the script until it waits or ends."""
        for _ in range(COMMANDS_PER_TICK):
            command = self._script.next_command(self._now, self.mode)
            if command is None:
                return
            self._obey(command)


def _clip_both(speeds_mm: tuple[int, ...]) -> tuple[int, int]:
    right, left = map(_clip, speeds_mm)
    return right, left


def _clip(speed_mm: int) -> int:
    return min(max(speed_mm, -oi.MAX_WHEEL_SPEED_MM), oi.MAX_WHEEL_SPEED_MM)
