"""How the firmware of an emulated URG-04LX answers requests in SCIP 1.1 and 2.0; no timing.

Sources: the SCIP 2.0 specification (C-42-03320B), called "the specification" below; texts and
states as in a capture of firmware 3.1.04. The answer of SCIP 1.1 to ``VV`` is undocumented; here
``VV`` is an unknown request.
"""

from __future__ import annotations

from collections.abc import Callable

from scan3d_twin.core.types import VALID, LidarSpec, ScanLine
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg import replies as scip_replies
from scan3d_twin.devices.urg.codec import Request, RequestError, ScanRequest
from scan3d_twin.devices.urg.emulated_quirks import Stream, UrgProfile
from scan3d_twin.devices.urg.replies import Scan

HAS_HS = (3, 2, 0)
"""First firmware that has HS (sensitivity); the specification."""
HAS_DB = (3, 3, 0)
"""First firmware that has DB (simulated malfunctions); the specification."""
_MULTIECHO = (b"ME", b"GE", b"HD", b"HE", b"ND", b"NE")
"""Requests of later lidars for multiple echoes and for intensities."""

Latest = Callable[[float], ScanLine | None]
"""Returns the last complete turn before a time [s]."""


class Firmware:
    """The state of the sensor, and its answers.

    Attributes:
        profile: The sensor and the quirks of its firmware.
        baud: Bit rate [bit/s].
        wanted_baud: Bit rate from the end of the current reply on [bit/s].
        scip1: Whether it speaks SCIP 1.1.
        laser: Whether the laser is on.
        stream: The running stream, if any.
        time_mode: Whether the time mode is on (TM0).
        mute: Whether it stays silent until the next power-up.
    """

    def __init__(self, profile: UrgProfile, spec: LidarSpec, latest: Latest) -> None:
        self.profile = profile
        self._latest = latest

        # Relate steps to the beams of the hardware interface
        first = round(spec.elevations[0] / urg04lx.step_angle(urg04lx.FRONT_STEP + 1))
        self._first_step = urg04lx.FRONT_STEP + first
        self._turns_per_line = round(spec.line_period / urg04lx.REVOLUTION)

        # Handlers by command
        self._handlers: dict[str, Callable[[Request, float], tuple[str, list[bytes]]]] = {
            **{"VV": self._version, "PP": self._parameters, "II": self._state},
            **{"BM": self._laser_on, "QT": self._quit, "RS": self._reset, "TM": self._time},
            **{"SS": self._speed, "CR": self._motor, "HS": self._sensitivity, "DB": self._debug},
            **{"GD": self._get, "GS": self._get, "MD": self._start, "MS": self._start},
        }

        # Power up
        self.power_up(0.0)
        self._timer_zero = -profile.timer_ms / 1000

    def power_up(self, now: float) -> None:
        """Reset to the state after power-up at ``now`` [s]; the timer starts at 0."""
        self.baud = self.wanted_baud = self.profile.baud
        self.scip1 = self.profile.scip1
        self.laser = self.scip1
        self.stream: Stream | None = None
        self.time_mode = False
        self.mute = False
        self._speed_step, self._high_sensitivity, self._malfunction = 0, False, 0
        self._timer_zero = now

    def timer_ms(self, now: float) -> int:
        """Return the sensor's timer at ``now`` [s], modulo 2**24 [ms]."""
        elapsed = (now - self._timer_zero) * (1 + self.profile.skew)
        return int(elapsed * 1000) % (1 << scip.TIMER_BITS)

    def answer(self, line: bytes, now: float, seen: set[str]) -> bytes:
        """Return the reply to one request.

        Args:
            line: The request without its terminator.
            now: Time of the tick [s].
            seen: Commands already answered on this tick; this one is added.
        """
        # Special cases: SCIP 1.1, and the mute quirk
        if self.scip1:
            return self._answer_scip1(line, now)
        if self.profile.mute_on_multiecho and line.startswith(_MULTIECHO):
            self.mute = True
            return b""

        # Parse and dispatch
        echo = line.decode("latin-1")
        try:
            request = scip.parse_request(line)
            if request.command in seen:
                return scip_replies.encode_reply(echo, "0B")
            seen.add(request.command)
            if self.time_mode and request.command != "TM":
                return scip_replies.encode_reply(echo, "0E")
            status, lines = self._handlers[request.command](request, now)
        except RequestError as error:
            return scip_replies.encode_reply(echo, error.status)
        return scip_replies.encode_reply(echo, status, lines)

    def is_due(self, line: ScanLine) -> bool:
        """Return whether the stream sends ``line``, a turn just completed; count skipped turns."""
        stream = self.stream
        if stream is None or line.stamp < stream.since or self._malfunction:
            return False
        stream.skipped += self._turns_per_line
        return stream.skipped > stream.request.skip

    def send(self, line: ScanLine) -> bytes:
        """Return ``line`` as the next scan of the stream."""
        stream = self.stream
        assert stream is not None

        # Count down, and stop after the last scan
        stream.skipped = 0
        if stream.remaining is not None:
            stream.remaining -= 1
            if stream.remaining == 0:
                self.stream, self.laser = None, False

        # Encode
        echo = stream.request.request(stream.remaining or 0).echo
        return scip_replies.encode_reply(echo, "99", self._scan(line, stream.request))

    def _scan(self, line: ScanLine, request: ScanRequest) -> list[bytes]:
        values = self._values(line, request.first, request.last, request.cluster)
        limit = (1 << 6 * request.width) - 1
        scan = Scan(self.timer_ms(line.stamp), [min(value, limit) for value in values])
        return scip_replies.encode_scan(scan, request.width)

    def _values(self, line: ScanLine, first: int, last: int, cluster: int) -> list[int]:
        """Return the distances [mm] or error codes; for a cluster its smallest distance."""
        # Distances in mm by step
        mm = [
            round(1000 * distance) if code == VALID else int(code)
            for distance, code in zip(line.ranges.tolist(), line.codes.tolist(), strict=True)
        ]
        places = range(first - self._first_step, last + 1 - self._first_step)
        steps = [mm[i] if 0 <= i < len(mm) else urg04lx.NO_RETURN for i in places]

        # Merge the clusters
        width = max(1, cluster)
        groups = (steps[i : i + width] for i in range(0, len(steps), width))
        return [
            min((v for v in group if v >= urg04lx.MIN_RANGE_MM), default=group[0])
            for group in groups
        ]

    def _version(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        major, minor, patch = self.profile.firmware
        lines = [
            scip_replies.encode_text("VEND", "Hokuyo Automatic Co.,Ltd."),
            scip_replies.encode_text("PROD", "SOKUIKI Sensor URG-04LX"),
            scip_replies.encode_text("FIRM", f"{major}.{minor}.{patch:02d}(02/Aug./2007)"),
            scip_replies.encode_text("PROT", "SCIP 2.0"),
            scip_replies.encode_text("SERI", "H0000001"),
        ]
        if self.profile.faulty_version:
            lines[-1:] = [lines[-1][:-1] + b"?", b"I"]
        return "00", lines

    def _parameters(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        values = {
            "MODL": "URG-04LX(Hokuyo Automatic Co.,Ltd.)",
            "DMIN": urg04lx.MIN_RANGE_MM,
            "DMAX": 5600,
            "ARES": urg04lx.STEPS_PER_TURN,
            "AMIN": urg04lx.FIRST_STEP,
            "AMAX": urg04lx.LAST_STEP,
            "AFRT": urg04lx.FRONT_STEP,
            "SCAN": 600,
        }
        return "00", [scip_replies.encode_text(k, str(v)) for k, v in values.items()]

    def _state(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        values = {
            "MODL": "URG-04LX(Hokuyo Automatic Co.,Ltd.)",
            "LASR": "ON" if self.laser else "OFF",
            "SCSP": "Initial(600[rpm])<-Default setting by user",
            "MESM": "HIGH SENSITIVITY" if self._high_sensitivity else "CLASSIC",
            "SBPS": f"{self.baud}[bps]<-Default setting by user",
            "TIME": f"{self.timer_ms(now):06X}",
            "STAT": "Sensor works well." if not self._malfunction else "Malfunction simulated.",
        }
        return "00", [scip_replies.encode_text(k, v) for k, v in values.items()]

    def _laser_on(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        status = "02" if self.laser else "00"
        self.laser = True
        return status, []

    def _quit(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        self.stream, self.laser = None, False
        return "00", []

    def _reset(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        self.stream, self.laser, self._timer_zero = None, False, now
        self._speed_step, self._high_sensitivity, self._malfunction = 0, False, 0
        self.wanted_baud = self.profile.baud
        return "00", []

    def _time(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        if request.parameters not in "012":
            return "01", []
        if request.parameters == "1":
            lines = [scip_replies.encode_time(self.timer_ms(now))]
            return ("00", lines) if self.time_mode else ("04", [])
        if self.time_mode == (request.parameters == "0"):
            return ("02" if self.time_mode else "03"), []
        self.stream, self.laser = None, False
        self.time_mode = not self.time_mode
        return "00", []

    def _speed(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        if not request.parameters.isdecimal():
            return "01", []
        baud = int(request.parameters)
        if baud not in scip.BAUDS or (baud == 38400 and not self.profile.knows_38400):
            return "02", []
        if baud == self.baud:
            return "03", []
        self.wanted_baud = baud
        return "00", []

    def _motor(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        if not request.parameters.isdecimal():
            return "01", []
        step = int(request.parameters)
        if step > 10 and step != 99:
            return "02", []
        status = "03" if step == self._speed_step else "00"
        self._speed_step = 0 if step == 99 else step
        return status, []

    def _sensitivity(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        if self.profile.firmware < HAS_HS:
            raise RequestError("0E", "HS is not known to this firmware")
        if not request.parameters.isdecimal():
            return "01", []
        if request.parameters not in "01":
            return "02", []
        high = request.parameters == "1"
        status = "03" if high == self._high_sensitivity else "00"
        self._high_sensitivity = high
        return status, []

    def _debug(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        if self.profile.firmware < HAS_DB:
            raise RequestError("0E", "DB is not known to this firmware")
        if not request.parameters.isdecimal():
            return "01", []
        number = int(request.parameters)
        if number != 10 and not 1 <= number <= 5:
            return "02", []
        self._malfunction = 0 if number == 10 else number
        return "00", []

    def interruption(self, malfunction: int) -> bytes:
        """Return the block that reports the stream as halted (21 to 49) or resumed (98)."""
        if self.stream is None:
            return b""
        echo = self.stream.request.request(self.stream.remaining or 0).echo
        return scip_replies.encode_reply(echo, f"{20 + malfunction}" if malfunction else "98")

    @property
    def malfunction(self) -> int:
        """The malfunction simulated by DB, 1 to 5; 0 is none."""
        return self._malfunction

    def _get(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        scan = scip.parse_scan_request(request, urg04lx.LAST_POINT)
        line = self._latest(now)
        if not self.laser or line is None:
            return "10", []
        return "00", self._scan(line, scan)

    def _start(self, request: Request, now: float) -> tuple[str, list[bytes]]:
        scan = scip.parse_scan_request(request, urg04lx.LAST_POINT)
        if self.stream is not None:
            return "0B", []
        self.laser = True
        self.stream = Stream(scan, now, scan.count or None)
        return "00", []

    def _answer_scip1(self, line: bytes, now: float) -> bytes:
        """Return the reply in SCIP 1.1; unknown requests are answered with E."""
        echo, status, lines = line.decode("latin-1"), "0", list[bytes]()

        # Dispatch
        if line == scip.SWITCH.encode():
            self.scip1, self.laser = False, False
        elif line == b"V":
            lines = [text[:-2] for text in self._version(Request("VV"), now)[1]]
        elif line in (b"L0", b"L1"):
            self.laser = line == b"L1"
        elif line[:1] == b"S" and line[1:7].isdigit() and int(line[1:7]) in scip.BAUDS:
            self.wanted_baud = int(line[1:7])
        elif line[:1] == b"G" and self.laser:
            status, lines = self._get_scip1(line, now)
        else:
            status = "E"

        return scip_replies.encode_old_reply(echo, status, lines)

    def _get_scip1(self, line: bytes, now: float) -> tuple[str, list[bytes]]:
        try:
            scan = scip.parse_old_scan_request(line, urg04lx.LAST_POINT)
        except RequestError as error:
            return error.status, []
        latest = self._latest(now)
        if latest is None:
            return "E", []
        values = self._values(latest, scan.first, scan.last, scan.cluster)
        return "0", scip_replies.encode_old_scan([min(value, 4095) for value in values])
