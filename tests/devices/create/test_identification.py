"""Which base is on the line, on lines that are slow, lossy, or of another device."""

from itertools import product

import pytest
from kinematic import JumpingClock, KinematicBase
from virtual import VirtualClock

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.devices.create.codec import CREATE1, CREATE2, CommandParser, Op
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.identification import AGREEING, REFUSALS, Evidence, find_base
from scan3d_twin.devices.create.link import BAUDS
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.links.line_model import NO_FAULTS, Faults, Line, Wire
from scan3d_twin.devices.links.uart import Uart

MODELS = pytest.mark.parametrize("model", [CREATE1, CREATE2], ids=lambda model: model.name)


class Bench:
    """An emulated base, and a line to it in virtual time."""

    def __init__(self, model, faults=NO_FAULTS, latency=0.0, seed=0):
        self.clock = JumpingClock(KinematicBase())
        self.device = CreateEmulator(self.clock._base, model)
        self.wire = Wire(Line(self.device, faults, seed, latency), self.clock)

    def find(self, stated=None):
        return find_base(self.wire, self.clock, stated)

    def without(self, lost):
        """Lose every command that ``lost`` holds for."""
        obey = self.device._obey
        self.device._obey = lambda command: None if lost(command) else obey(command)
        return self


@MODELS
@pytest.mark.parametrize("latency", [0.0, 0.03, 0.05, 0.07, 0.1, 0.15])
def test_an_answer_that_comes_late_is_an_answer(model, latency):
    bench = Bench(model, latency=latency)
    assert bench.find().model is model
    assert bench.clock.now() < 2.0
    assert bench.device.mode is Mode.PASSIVE


@MODELS
def test_no_base_is_taken_for_the_other_on_a_bad_line(model):
    """A small share of what benchmarks/base_identity.py counts."""
    named, words = 0, []
    for corrupt, seed in product((0.001, 0.01), range(1000, 1020)):
        bench = Bench(model, Faults(corrupt, corrupt, corrupt), seed=seed)
        try:
            assert bench.find().model is model
            named += 1
        except LinkError as error:
            words.append(str(error))
        assert bench.clock.now() < 3.0
    assert all("not clearly which" in each or "no Create answers" in each for each in words)
    assert named >= 36


def test_a_question_that_is_lost_names_no_create_1():
    """The base answers all other questions, so that it seems to refuse the encoder counts."""
    asked = []

    def is_first_of_counts(command):
        if 43 in command.data:
            asked.append(command)
        return 43 in command.data and len(asked) <= 4

    bench = Bench(CREATE2).without(is_first_of_counts)
    assert bench.find().model is CREATE2
    assert len(asked) > 4


def counts(command):
    return 43 in command.data


def test_a_base_that_is_neither_is_refused_with_what_was_seen_and_can_be_stated():
    with pytest.raises(LinkError, match=r"115200 baud, but not clearly which: .* 0 frames") as seen:
        Bench(CREATE2).without(counts).find()
    assert "--robot create1 or --robot create2" in str(seen.value)
    assert "does not answer Show Script" in str(seen.value)
    assert not isinstance(seen.value, LinkTimeoutError)
    assert Bench(CREATE2).without(counts).find(CREATE2).model is CREATE2


def test_a_create_1_that_shows_no_script_is_known_by_its_baud_rate():
    def script(command):
        return command.op is Op.SHOW_SCRIPT

    bench = Bench(CREATE1).without(script)
    assert bench.find().model is CREATE1
    assert bench.clock.now() < 3.0


@MODELS
def test_a_stated_base_opens_at_once_and_the_other_one_is_refused(model):
    other = CREATE2 if model is CREATE1 else CREATE1
    assert Bench(model).find(model).model is model
    with pytest.raises(LinkError, match=f"the base on the port is no {other.name}: .*leave out"):
        Bench(model).find(other)


class Deaf:
    """A ``Transport`` on which nothing answers; it keeps what is sent, with time and baud rate."""

    def __init__(self, clock):
        self.clock, self.baud, self.sent = clock, 0, []

    def read(self, timeout):
        self.clock.sleep(timeout)
        return b""

    def write(self, data):
        self.sent.append((self.clock.now(), self.baud, data))

    def set_baud(self, baud):
        self.baud = baud


@pytest.fixture(scope="module")
def whole_search():
    """What is sent where no base answers: [(time, baud rate, bytes)]."""
    line = Deaf(VirtualClock())
    with pytest.raises(LinkTimeoutError, match="no Create answers"):
        find_base(line, line.clock)
    assert line.clock.now() < 3.0
    return line.sent


@MODELS
@pytest.mark.parametrize("own", BAUDS)
def test_a_search_at_other_baud_rates_makes_no_base_deaf(whole_search, model, own):
    """A base on a line without faults must not hear Reset, Baud or Wait, whatever its rate is."""
    assert {baud for _, baud, _ in whole_search} == {*BAUDS, 300}
    heard = set()
    for seed in range(10):
        uart, parser = Uart(seed), CommandParser(model)
        for when, baud, data in whole_search:
            if baud not in (own, 300):
                got = uart.take(data, when, baud, own) + uart.idle(when + 1.0)
                heard |= {command.op for command in parser.feed(got)}
    harmless = {Op.START, Op.SCRIPT, Op.SCHEDULING_LEDS, Op.SET_DAY_TIME}
    assert heard <= harmless


def test_a_stated_create_1_is_asked_at_its_own_baud_rate_first():
    line = Deaf(VirtualClock())
    with pytest.raises(LinkTimeoutError):
        find_base(line, line.clock, CREATE1)
    assert next(baud for _, baud, _ in line.sent) == CREATE1.baud


@pytest.mark.parametrize("seed", [1012, 1045, 1116])
def test_a_create_1_that_heard_random_bytes_at_115200_baud_is_found(seed):
    """With these seeds a line that made random bytes of a wrong baud rate made it deaf."""
    assert Bench(CREATE1, seed=seed).find().model is CREATE1


def test_an_answer_that_a_busy_computer_reads_late_is_an_answer():
    """Each read takes as long as half of the time for an answer, or more."""
    bench = Bench(CREATE2)
    read = bench.wire.read

    def late(timeout):
        bench.clock.sleep(0.35)
        return read(timeout)

    bench.wire.read = late
    assert bench.find().model is CREATE2


@pytest.mark.parametrize("lost", [1, 2])
def test_a_lost_start_is_no_wrong_mode(lost):
    """A base that another program left in Safe reports 2, as some firmware does in Passive."""
    bench = Bench(CREATE2)
    bench.device.receive(bytes([Op.START, Op.SAFE]), 0.0)
    starts = []

    def first_starts(command):
        if command.op is Op.START:
            starts.append(command)
        return command.op is Op.START and len(starts) <= lost

    assert bench.without(first_starts).find().mode_offset == 0
    assert len(starts) == lost + 1


def test_evidence_decides_only_where_it_agrees():
    def model(**seen):
        return Evidence(**{"baud": 115200, **seen}).model()

    assert model() is None
    assert model(counts=AGREEING - 1) is None
    assert model(counts=AGREEING) is CREATE2
    assert model(counts=AGREEING, shows_script=True) is None
    assert model(refused=REFUSALS) is None
    assert model(refused=REFUSALS, baud=57600) is CREATE1
    assert model(refused=REFUSALS - 1, baud=57600) is None
    assert model(refused=1, shows_script=True) is CREATE1
    assert model(refused=0, shows_script=True) is None
