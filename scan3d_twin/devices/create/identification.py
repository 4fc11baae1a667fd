"""Finding a Create on a serial line: its baud rate, its mode and its model, by answers that agree.

No single answer decides, and no single missing one: a byte may be lost, and a line may be slow.

* Only a Create 2 has encoder counts (packets 43 and 44). It is named after ``AGREEING`` frames that
  contain them, each with its checksum. A Roomba 500 to 800 answers like a Create 2: only the user
  can tell which it is.
* A Create 1 leaves that question unanswered (a refusal): the base answers other questions right
  before and right after it, so that neither the line nor the base is at fault. Only a Create 1 has
  the command Show Script: it is named after a refusal and two equal answers to that. Where they do
  not come, it takes ``REFUSALS`` refusals and the baud rate of a Create 1.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, product

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, Model, Op, StreamParser
from scan3d_twin.devices.create.link import (
    BAUDS,
    COUNTS,
    HALF_ANYTHING,
    HALF_DRIVE,
    HALF_STREAM,
    MODE_SETTLE,
    Contact,
    Values,
    call_back,
)
from scan3d_twin.devices.create.packets import Mode, Packet
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.transport import Transport

log = logging.getLogger(__name__)

CONNECT_TIMEOUT = 2.9
"""Time within which a base is found and its model is clear [s]; assumption: people wait 3 s."""
BOOT_TIMEOUT = 6.0
"""The same from when a base says that it boots [s]; it is deaf for 3 s then (assumption)."""
BOOTS = b"bl-start"
"""What a Create 2 and a Roomba print when they boot; robotics.stackexchange 7121."""
ANSWER_TIMEOUT = 0.3
"""Time within which an answer begins [s]: ten periods, and 150 ms for a slow line (a network bridge
or a busy computer); assumption."""
EXTRA_TIME = 0.1
"""Time that the question for encoder counts is given beyond the delay of the answer before it [s]:
seven periods; assumption."""
REPEAT = 0.06
"""Time between two repetitions of an unanswered request [s]: four periods. Each repetition may be
corrupted too, into a command that makes the base deaf: only every second one comes so soon."""
UNKNOWN_DELAY = 0.1
"""Delay of the line as long as no answer has shown it [s]; assumption."""
QUIET = 3 * oi.PERIOD
"""Time without a byte after which a paused line is quiet [s]."""
ROUNDING = 1e-6
"""Waiting time below which a time-out has passed [s]."""
AGREEING = 3
"""Number of agreeing answers that decide: with 8-bit checksums, chance alone gives one in 10^7."""
REFUSALS = 3
"""Number of refusals that decide."""
STARTS = 3
"""Number of Start commands after which the base must be in mode Passive: one may be lost."""
MODE_QUESTION = (Packet.WALL, Packet.MODE)
"""Question for the mode. Here and below the smallest packet comes first that is no opcode, as 7 is:
where the number of packets is lost on the way, the base takes that one for it and waits for so many
bytes; where the opcode is lost, it takes what follows for commands."""
CONTROLS = (
    (Packet.WALL, Packet.REQUESTED_RIGHT, Packet.REQUESTED_LEFT),
    (Packet.WALL, Packet.REQUESTED_VELOCITY, Packet.REQUESTED_RADIUS),
)
"""Questions that every base answers, as long as ``QUESTION``; in turn, so that an answer is new."""
QUESTION = (Packet.WALL, *COUNTS)
"""Question that only a Create 2 answers."""


@dataclass(slots=True)
class Evidence:
    """What a base has shown of its model.

    Attributes:
        baud: Its baud rate [bit/s].
        counts: Frames with encoder counts.
        asked: Questions for encoder counts.
        refused: Those that were not answered, though the questions before and after them were.
        controls: Answers to ``CONTROLS``.
        shows_script: Whether it answers Show Script.
    """

    baud: int
    counts: int = 0
    asked: int = 0
    refused: int = 0
    controls: int = 0
    shows_script: bool = False

    def model(self) -> Model | None:
        """Return the model that all of this shows; None if it is not clear."""
        if self.counts:
            return CREATE2 if self.counts >= AGREEING and not self.shows_script else None
        wanted = 1 if self.shows_script else REFUSALS
        has_features = self.shows_script or self.baud == CREATE1.baud
        return CREATE1 if self.refused >= wanted and has_features else None

    def supports(self, model: Model) -> bool:
        """Return whether this is enough for a base that is stated to be a ``model``."""
        return self.counts > 0 if model.has_counts else self.refused > 0 and not self.counts

    def __str__(self) -> str:
        script = "answers" if self.shows_script else "does not answer"
        return (
            f"encoder counts (Create 2 only) in {self.counts} frames, refused by {self.refused} of "
            f"{self.asked} questions; it {script} Show Script (Create 1 only)"
        )


def find_base(transport: Transport, clock: Clock, stated: Model | None = None) -> Contact:
    """Find the base on the line; afterwards it is in mode Passive and sends nothing.

    The base does not move.

    Args:
        transport: The line to the base.
        clock: Times the answers.
        stated: The model that the user states; decides where the answers do not.

    Raises:
        LinkTimeoutError: Nothing answers in the Open Interface at any baud rate.
        LinkError: It is not clear which model answers, or not the stated one does, or the port is
            gone.
    """
    questioner = _Questioner(transport, clock)
    # On a noisy line a base at a wrong baud rate may hear Reset, or on a Create 1 Wait, which makes
    # it deaf: try that of a stated model first
    bauds = BAUDS if stated is None else dict.fromkeys((stated.baud, *BAUDS))
    # It may hear the start of a long command, too: complete ever longer ones
    for pad, baud in cycle(product((HALF_DRIVE, HALF_STREAM, HALF_ANYTHING), bauds)):
        if questioner.is_over(_start_time(pad, baud)):
            break
        if pad is HALF_ANYTHING and baud == next(iter(bauds)):
            clock.sleep(call_back(transport, BAUDS[0]))

        # Find the baud rate and the mode
        transport.set_baud(baud)
        evidence = Evidence(baud)
        mode = questioner.start(pad, evidence)
        if mode is None:
            continue

        # Find the model
        questioner.gather(evidence, stated)
        transport.write(oi.command(Op.PAUSE_RESUME, 0))
        model = _decide(evidence, stated)
        log.info("found a %s at %d baud: %s", model.name, baud, evidence)
        return Contact(model, baud, mode - Mode.PASSIVE)

    speeds = ", ".join(map(str, BAUDS))
    raise LinkTimeoutError(
        f"no Create answers at {speeds} baud: switch it on (Clean or Power button), check the "
        "cable; after days on the charger take its battery out for 10 s"
    )


def _start_time(pad: bytes, baud: int) -> float:
    """Return how long a base takes to start behind ``pad`` at ``baud`` [bit/s], in s."""
    return len(pad) * BITS_PER_BYTE / baud + MODE_SETTLE


def _decide(evidence: Evidence, stated: Model | None) -> Model:
    """Return the model of the base.

    Raises:
        LinkError: It is not clear, or not the one that is stated.
    """
    shown = evidence.model()
    if shown is None:
        if stated is not None:
            return stated
        raise LinkError(
            f"a base answers at {evidence.baud} baud, but not clearly which: {evidence}; check the "
            f"cable, or state it with --robot {CREATE1.name} or --robot {CREATE2.name}"
        )
    if stated is not None and stated.has_counts != shown.has_counts:
        raise LinkError(
            f"the base on the port is no {stated.name}: {evidence}; leave out --robot (in a "
            "--config file too: robot), or name another port with --port"
        )
    return shown if stated is None else stated


class _Questioner:
    """Asks a base for streams of a few packets, and listens for the answers."""

    def __init__(self, transport: Transport, clock: Clock) -> None:
        self._transport, self._clock = transport, clock
        self._header_summed: bool | None = None
        self._delay = UNKNOWN_DELAY
        self._counts = StreamParser(QUESTION)
        self._tail, self._give_up = b"", clock.now() + CONNECT_TIMEOUT

    def is_over(self, needed: float = 0.0) -> bool:
        """Return whether less time than ``needed`` [s] is left for all questions."""
        return self._clock.now() + needed > self._give_up - ROUNDING

    def start(self, pad: bytes, evidence: Evidence) -> int | None:
        """Bring the base into mode Passive and return the mode that it then reports.

        None if no base answers at the baud rate of ``evidence``, to which the answers are added. It
        is sent ``pad`` first, to complete what it has not received in full. Where it does not
        report Passive, Start may have been lost, so it is sent again before the mode counts as
        reported one too high.
        """
        mode = None
        for _ in range(STARTS):
            if self.is_over(_start_time(pad, evidence.baud)):
                break
            self._transport.write(pad + oi.command(Op.START))
            self._clock.sleep(_start_time(pad, evidence.baud))
            answers = self._ask(MODE_QUESTION, ANSWER_TIMEOUT, evidence)
            heard = {values[Packet.MODE] for values in answers}
            evidence.controls += bool(heard)
            if not heard:
                return mode
            if heard in ({Mode.PASSIVE}, {Mode.PASSIVE + 1}):
                (mode,) = heard
            if mode == Mode.PASSIVE:
                break
        return mode

    def gather(self, evidence: Evidence, stated: Model | None) -> None:
        """Ask the base until its model is clear, or the ``stated`` one is supported; add it all."""
        self._counts = StreamParser(QUESTION)
        # The answer to ``start`` was the first control
        is_heard, pads = True, cycle((HALF_STREAM, HALF_STREAM, HALF_ANYTHING))
        for control in cycle(CONTROLS):
            # Ask for the encoder counts
            was_unanswered = False
            if is_heard:
                evidence.asked += 1
                self._ask(QUESTION, self._delay + EXTRA_TIME, evidence)
                was_unanswered = not evidence.counts
            else:
                self._transport.write(next(pads))
            if self._is_enough(evidence, stated):
                return

            # Find out whether the base answers at all
            is_heard = bool(self._ask(control, ANSWER_TIMEOUT, evidence, enough=1))
            evidence.controls += is_heard
            evidence.refused += was_unanswered and is_heard
            if self._is_enough(evidence, stated) or self.is_over():
                return

            # Ask for what only a Create 1 has
            if was_unanswered and is_heard:
                evidence.shows_script |= self._shows_script()
                if self._is_enough(evidence, stated):
                    return

    @staticmethod
    def _is_enough(evidence: Evidence, stated: Model | None) -> bool:
        """Return whether no further answers are needed."""
        supported = stated is not None and evidence.supports(stated)
        return supported or evidence.model() is not None

    def _ask(
        self,
        packets: Sequence[Packet],
        timeout: float,
        evidence: Evidence,
        enough: int = AGREEING,
    ) -> list[Values]:
        """Request a stream of ``packets`` until it comes; return its first frames.

        That is ``enough`` of them, or fewer if they do not come within ``timeout`` [s]. Encoder
        counts are added to ``evidence`` whatever was asked: they may be late.
        """
        is_question, frames = packets is QUESTION, list[Values]()
        parser = self._counts if is_question else StreamParser(packets)
        parser.header_summed = self._header_summed
        asked_at = now = request_at = self._clock.now()
        waits = cycle((REPEAT, self._delay + REPEAT))
        deadline = min(asked_at + timeout, self._give_up)
        # Read once after the deadline: this computer may have been busy meanwhile
        while len(frames) < enough and now < deadline - ROUNDING:
            # Request, and take what has arrived
            if now >= request_at:
                self._transport.write(oi.stream(packets))
                request_at = now + next(waits)
            data = self._read(max(0.0, min(oi.PERIOD, deadline - self._clock.now())))
            now = self._clock.now()

            # Sort the answers
            answers = parser.feed(data)
            if answers and not frames and not is_question:
                self._delay = now - asked_at
            frames += answers
            if not is_question:
                evidence.counts += len(self._counts.feed(data))
        if is_question:
            evidence.counts += len(frames)
        self._header_summed = parser.header_summed
        return frames

    def _shows_script(self) -> bool:
        """Return whether the base answers Show Script twice alike: its length, then its bytes.

        The first answer follows what the stream still held: Show Script ends it.
        """
        before = self._show_script()
        answer = self._show_script() if before else b""
        return len(answer) == 1 + next(iter(answer), 0) and before.endswith(answer)

    def _show_script(self) -> bytes:
        """Send Show Script; return what arrives until the line is quiet, b"" if it never is."""
        self._transport.write(oi.command(Op.SHOW_SCRIPT))
        data, timeout = b"", self._delay + 2 * QUIET
        deadline = min(self._clock.now() + timeout, self._give_up)
        while got := self._read(timeout):
            data, timeout = data + got, QUIET
            if self._clock.now() > deadline:
                return b""
        return data

    def _read(self, timeout: float) -> bytes:
        """Return what arrives within ``timeout`` [s]; wait longer for a base that boots."""
        left = self._give_up - self._clock.now()
        data = self._transport.read(max(0.0, min(timeout, left)))
        tail = self._tail + data
        if BOOTS in tail:
            self._give_up = self._clock.now() + BOOT_TIMEOUT
        self._tail = tail[1 - len(BOOTS) :]
        return data
