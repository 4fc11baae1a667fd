"""Finding a Create on a serial line: its baud rate, its mode and its model, by answers that agree.

No single answer decides, and no single missing one: a byte may be lost, and a line may be slow.

* Only a Create 2 has encoder counts (packets 43 and 44). It is named after ``AGREEING`` frames that
  contain them, each with its checksum. A Roomba 500 to 800 answers like a Create 2: only the user
  can tell which it is.
* A Create 1 leaves that question unanswered (a refusal): the base answers a question of the same
  length right before and right after it, so that neither the line nor the base is at fault. Only a
  Create 1 has the command Show Script: it is named after a refusal and two equal answers to that.
  Where they do not come, it takes ``REFUSALS`` refusals and the baud rate of a Create 1.
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
    MODE_SETTLE,
    Contact,
    Values,
    call_back,
)
from scan3d_twin.devices.create.packets import Mode, Packet
from scan3d_twin.devices.links.transport import Transport

log = logging.getLogger(__name__)

CONNECT_TIMEOUT = 8.0
"""Time within which a base is found, even while it boots after a reset [s]; assumption."""
IDENTIFY_TIMEOUT = 2.2
"""Time after the first answer within which the model is found [s]; assumption: with the search
before it, people wait less than 3 s."""
ANSWER_TIMEOUT = 0.3
"""Time within which an answer begins [s]: ten periods, and 150 ms for a slow line (a network bridge
or a busy computer); assumption."""
EXTRA_TIME = 0.1
"""Time that the question for encoder counts is given beyond the delay of the answer before it [s]:
seven periods; assumption."""
REPEAT = 0.06
"""Time between two repetitions of an unanswered request, beyond the delay of the line [s]: four
periods. Each repetition may be corrupted too, into a command that makes the base deaf."""
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
CONTROLS = (
    (Packet.MODE, Packet.REQUESTED_RIGHT, Packet.REQUESTED_LEFT),
    (Packet.MODE, Packet.REQUESTED_VELOCITY, Packet.REQUESTED_RADIUS),
)
"""Questions that every base answers, as long as ``QUESTION``; in turn, so that an answer is new."""
QUESTION = (Packet.MODE, *COUNTS)
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
    give_up = clock.now() + CONNECT_TIMEOUT
    questioner = _Questioner(transport, clock)
    # At a wrong baud rate the base may hear Reset, or on a Create 1 Wait, which makes it deaf: try
    # that of a stated model first
    bauds = BAUDS if stated is None else dict.fromkeys((stated.baud, *BAUDS))
    # It may hear the start of a long command, too: complete it every 2nd time
    tries = list(product((HALF_DRIVE, HALF_ANYTHING), bauds))
    for number, (pad, baud) in enumerate(cycle(tries)):
        if clock.now() > give_up:
            break
        if number and number % len(tries) == 0:
            clock.sleep(call_back(transport, BAUDS[0]))

        # Find the baud rate and the mode
        transport.set_baud(baud)
        mode = questioner.start(pad, baud)
        if mode is None:
            continue

        # Find the model
        evidence = Evidence(baud)
        questioner.gather(evidence, stated)
        transport.write(oi.command(Op.PAUSE_RESUME, 0))
        if evidence.controls:
            model = _decide(evidence, stated)
            log.info("found a %s at %d baud: %s", model.name, baud, evidence)
            return Contact(model, baud, mode - Mode.PASSIVE)

    speeds = ", ".join(map(str, BAUDS))
    raise LinkTimeoutError(
        f"no Create answers at {speeds} baud: switch it on (Clean or Power button), check the "
        "cable; after days on the charger take its battery out for 10 s"
    )


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

    def start(self, pad: bytes, baud: int) -> int | None:
        """Bring the base into mode Passive and return the mode that it then reports.

        None if no base answers at this ``baud`` rate [bit/s]. It is sent ``pad`` first, to complete
        what it has not received in full. Where it does not report Passive, Start may have been
        lost, so it is sent again before the mode counts as reported one too high.
        """
        mode = None
        for _ in range(STARTS):
            self._transport.write(pad + oi.command(Op.START))
            self._clock.sleep(len(pad) * 10 / baud + MODE_SETTLE)
            heard = {values[Packet.MODE] for values in self._ask([Packet.MODE], ANSWER_TIMEOUT)}
            if not heard:
                return mode
            if heard in ({Mode.PASSIVE}, {Mode.PASSIVE + 1}):
                (mode,) = heard
            if mode == Mode.PASSIVE:
                break
        return mode

    def gather(self, evidence: Evidence, stated: Model | None) -> None:
        """Ask the base until its model is clear, or the ``stated`` one is supported; add it all."""
        deadline = self._clock.now() + IDENTIFY_TIMEOUT
        self._counts = StreamParser(QUESTION)
        was_unanswered, pads = False, cycle((HALF_DRIVE, HALF_ANYTHING))
        for control in cycle(CONTROLS):
            # Find out whether the base answers, and how fast
            asked_at = self._clock.now()
            is_heard = bool(self._ask(control, ANSWER_TIMEOUT, evidence, enough=1))
            evidence.controls += is_heard
            evidence.refused += was_unanswered and is_heard
            if is_heard:
                self._delay = self._clock.now() - asked_at
            if was_unanswered and is_heard and not self._is_enough(evidence, stated):
                evidence.shows_script = evidence.shows_script or self._shows_script()
            if self._is_enough(evidence, stated) or self._clock.now() > deadline:
                return

            # Ask for the encoder counts
            was_unanswered = False
            if not is_heard:
                self._transport.write(next(pads))
                continue
            evidence.asked += 1
            self._ask(QUESTION, self._delay + EXTRA_TIME, evidence)
            was_unanswered = not evidence.counts
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
        evidence: Evidence | None = None,
        enough: int = AGREEING,
    ) -> list[Values]:
        """Request a stream of ``packets`` until it comes; return its first frames.

        That is ``enough`` of them, or fewer if they do not come within ``timeout`` [s]. Encoder
        counts are added to ``evidence`` whatever was asked: they may be late.
        """
        parser = self._counts if packets is QUESTION else StreamParser(packets)
        parser.header_summed = self._header_summed
        request_at = self._clock.now()
        deadline, frames = request_at + timeout, list[Values]()
        while (left := deadline - self._clock.now()) > ROUNDING and len(frames) < enough:
            if self._clock.now() >= request_at:
                self._transport.write(oi.stream(packets))
                request_at = self._clock.now() + self._delay + REPEAT
            data = self._transport.read(min(oi.PERIOD, left))
            frames += parser.feed(data)
            if evidence is not None and parser is not self._counts:
                evidence.counts += len(self._counts.feed(data))
        if evidence is not None and parser is self._counts:
            evidence.counts += len(frames)
        self._header_summed = parser.header_summed
        return frames

    def _shows_script(self) -> bool:
        """Return whether the base answers Show Script twice alike: its length, then its bytes."""
        # Wait until the line is quiet
        self._transport.write(oi.command(Op.PAUSE_RESUME, 0))
        self._read_until_quiet(self._delay + QUIET)

        # Ask twice
        answers = []
        for _ in range(2):
            self._transport.write(oi.command(Op.SHOW_SCRIPT))
            answers.append(self._read_until_quiet(self._delay + 2 * QUIET))
            if len(answers[-1]) != 1 + next(iter(answers[-1]), 0):
                return False
        return answers[0] == answers[1]

    def _read_until_quiet(self, timeout: float) -> bytes:
        """Return what arrives, from within ``timeout`` [s] until the line is quiet."""
        data = b""
        deadline = self._clock.now() + timeout + ANSWER_TIMEOUT
        while (got := self._transport.read(timeout)) and self._clock.now() < deadline:
            data, timeout = data + got, QUIET
        return data
