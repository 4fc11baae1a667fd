from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import (
    CREATE1,
    CREATE2,
    MODELS,
    Command,
    CommandParser,
    Op,
    StreamParser,
    encode_frame,
)
from scan3d_twin.devices.create.packets import Packet

CLIFF_AND_WALL = [29, 13]
VALUES = {29: 549, 13: 0}


def pieces(data, stream):
    """Cut ``stream`` anywhere."""
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    return [stream[a:b] for a, b in pairwise([0, *cuts, len(stream)])]


def commands(model):
    def of(op):
        fixed = model.opcodes[op]
        if op in (Op.SONG, Op.STREAM, Op.QUERY_LIST, Op.SCRIPT):
            unit = 2 if op is Op.SONG else 1
            head = st.binary(min_size=fixed - 1, max_size=fixed - 1)
            tail = st.integers(0, 20).flatmap(
                lambda n: st.binary(min_size=unit * n, max_size=unit * n).map(
                    lambda body: bytes([n]) + body
                )
            )
            return st.builds(lambda a, b: Command(op, a + b), head, tail)
        return st.binary(min_size=fixed, max_size=fixed).map(lambda d: Command(op, d))

    return st.sampled_from(sorted(model.opcodes)).flatmap(of)


# Golden bytes.


def test_the_stream_example_of_the_create_manual():
    # Create Open Interface, page 14: the checksum leaves out the header.
    assert oi.stream(CLIFF_AND_WALL) == bytes([148, 2, 29, 13])
    frame = bytes([19, 5, 29, 2, 37, 13, 0, 170])
    assert encode_frame(CLIFF_AND_WALL, VALUES, header_summed=False) == frame
    assert StreamParser(CLIFF_AND_WALL).feed(4 * frame) == [VALUES]


@pytest.mark.parametrize(("checksum", "header_summed"), [(182, False), (163, True)])
def test_both_checksums_of_the_manuals(checksum, header_summed):
    # Both manuals print the value's low byte as 25, which is 537; the sums go with it: 182 in the
    # Create manual, page 14; 163 in the Create 2 manual, "Stream".
    frame = bytes([19, 5, 29, 2, 25, 13, 0, checksum])
    assert encode_frame(CLIFF_AND_WALL, {29: 537, 13: 0}, header_summed=header_summed) == frame
    parser = StreamParser(CLIFF_AND_WALL)
    assert parser.feed(3 * frame) == []
    assert parser.header_summed is header_summed
    assert parser.feed(frame) == [{29: 537, 13: 0}]


def test_the_drive_example_of_the_manuals():
    # Page 9: reverse at 200 mm/s while turning at a radius of 500 mm.
    assert oi.drive(-200, 500) == bytes([137, 255, 56, 1, 244])


def test_drive_direct_sends_the_right_wheel_first():
    # Page 10.
    assert oi.drive_direct(256, -2) == bytes([145, 1, 0, 255, 254])
    with pytest.raises(ValueError, match="500 mm/s"):
        oi.drive_direct(501, 0)


SCRIPTS = {
    "40 cm": (
        [152, 13, 137, 1, 44, 128, 0, 156, 1, 144, 137, 0, 0, 0, 0],
        [Op.DRIVE, Op.WAIT_DISTANCE, Op.DRIVE],
    ),
    "square": (
        [152, 17, 137, 1, 44, 128, 0, 156, 1, 144, 137, 1, 44, 0, 1, 157, 0, 90, 153],
        [Op.DRIVE, Op.WAIT_DISTANCE, Op.DRIVE, Op.WAIT_ANGLE, Op.PLAY_SCRIPT],
    ),
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_scripts_of_the_create_manual(name):
    # Page 15.
    stored, ops = SCRIPTS[name]
    (command,) = CommandParser(CREATE1).feed(bytes(stored))
    assert command.op is Op.SCRIPT
    inner = CommandParser(CREATE1).feed(command.data[1:])
    assert [each.op for each in inner] == ops
    assert inner[0].words() == (300, -32768)
    assert inner[1].words() == (400,)
    assert oi.script(b"".join(map(bytes, inner))) == bytes(stored)


def test_a_script_holds_100_bytes():
    assert len(oi.script(bytes(100))) == 102
    with pytest.raises(ValueError, match="100 bytes"):
        oi.script(bytes(101))


def test_the_opcodes_of_the_manuals():
    assert oi.command(Op.START) == bytes([128])
    assert oi.command(Op.SAFE) == bytes([131])
    assert oi.command(Op.FULL) == bytes([132])
    assert oi.command(Op.BAUD, 10) == bytes([129, 10])
    assert oi.BAUD_CODES[10] == 57600
    assert oi.BAUD_CODES[11] == 115200
    assert oi.sensors(100) == bytes([142, 100])
    assert oi.query([43, 44]) == bytes([149, 2, 43, 44])
    assert oi.command(Op.PAUSE_RESUME, 0) == bytes([150, 0])
    assert oi.command(Op.STOP) == bytes([173])


def test_the_numbers_of_the_two_models():
    assert (CREATE1.baud, CREATE2.baud) == (57600, 115200)
    assert CREATE2.mm_per_count == pytest.approx(0.44456, abs=1e-5)
    assert 65536 * CREATE2.mm_per_count / 1000 == pytest.approx(29.135, abs=1e-3)
    assert CREATE1.opcodes[Op.DEMO] == 1
    assert CREATE2.opcodes[Op.DEMO] == 0
    assert set(MODELS) == {"create1", "create2"}


@pytest.mark.parametrize(("baud", "budget"), [(57600, 86), (115200, 172), (19200, 28)])
def test_the_bytes_in_15_ms(baud, budget):
    # 86 at 57600 baud: page 14.
    packets = [Packet.MODE] * ((budget - 3) // 2)
    rest = [] if (budget - 3) % 2 == 0 else [Packet.LEFT_COUNTS]
    packets = packets[: len(packets) - len(rest)] + rest
    assert oi.frame_size(packets) == budget
    assert oi.fits_stream(packets, baud)
    assert not oi.fits_stream([*packets, Packet.MODE], baud)


# Properties.


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@given(data=st.data())
def test_commands_survive_any_cut(model, data):
    sent = data.draw(st.lists(commands(model), max_size=6))
    parser = CommandParser(model)
    stream = b"".join(map(bytes, sent))
    assert [c for piece in pieces(data, stream) for c in parser.feed(piece)] == sent
    assert parser.skipped == 0


def test_unknown_bytes_are_skipped_and_counted():
    parser = CommandParser(CREATE2)
    assert parser.feed(bytes([0, 7, 255, 156, 131])) == [Command(Op.RESET), Command(Op.SAFE)]
    assert parser.skipped == 3


def test_half_a_command_can_be_forgotten():
    parser = CommandParser(CREATE2)
    assert parser.feed(bytes([145, 0])) == []
    parser.reset()
    assert parser.feed(bytes([128])) == [Command(Op.START)]


frames = st.lists(
    st.fixed_dictionaries({43: st.integers(0, 65535), 35: st.integers(0, 255), 19: st.just(4869)}),
    min_size=8,
    max_size=12,
)


@given(frames, st.booleans(), st.data())
def test_frames_survive_any_cut(values, header_summed, data):
    parser = StreamParser([43, 35, 19])
    stream = b"".join(encode_frame([43, 35, 19], v, header_summed=header_summed) for v in values)
    got = [frame for piece in pieces(data, stream) for frame in parser.feed(piece)]
    assert got == values[StreamParser.LOCK :]
    assert parser.bad == 0


@given(frames, st.binary(max_size=60), st.data())
def test_garbage_before_the_frames_costs_none_of_the_later_ones(values, garbage, data):
    parser = StreamParser([43, 35, 19])
    stream = b"".join(encode_frame([43, 35, 19], v, header_summed=True) for v in values)
    got = [frame for piece in pieces(data, garbage + stream) for frame in parser.feed(piece)]
    assert got
    assert got == values[-len(got) :]


@given(st.integers(0, 65535), st.integers(0, 8 * 11 - 1))
def test_a_flipped_bit_is_never_accepted(count, bit):
    packets = [43, 35, 19]
    good = encode_frame(packets, {43: count, 35: 2, 19: 19 * 257}, header_summed=True)
    assert len(good) == 11
    broken = bytearray(good)
    broken[bit // 8] ^= 1 << bit % 8
    parser = StreamParser(packets)
    parser.feed(3 * good)
    assert parser.feed(bytes(broken)) == []
    assert len(parser.feed(2 * good)) >= 1


@given(st.integers(0, 10), st.data())
def test_a_lost_or_inserted_byte_costs_one_frame_at_most_two(place, data):
    packets = [43, 35, 19]
    good = encode_frame(packets, {43: 4883, 35: 19, 19: 4864}, header_summed=False)
    broken = good[:place] + data.draw(st.sampled_from([b"", bytes([19, 19])])) + good[place + 1 :]
    parser = StreamParser(packets)
    parser.feed(3 * good)
    assert len(parser.feed(broken + 3 * good)) >= 2


def test_the_other_checksum_is_not_taken_once_one_is_known():
    parser = StreamParser([35])
    parser.feed(3 * encode_frame([35], {35: 1}, header_summed=True))
    other = encode_frame([35], {35: 1}, header_summed=False)
    assert parser.feed(5 * other) == []
    assert parser.bad == 5


def test_frames_of_another_request_are_not_taken():
    parser = StreamParser([43, 44])
    foreign = encode_frame([44, 43], {43: 1, 44: 2}, header_summed=True)
    assert parser.feed(10 * foreign) == []
    assert parser.header_summed is None


@given(st.lists(st.binary(max_size=200), max_size=10))
def test_garbage_never_breaks_a_parser(chunks):
    stream, listener = StreamParser([7, 43, 44]), CommandParser(CREATE1)
    for chunk in chunks:
        stream.feed(chunk)
        listener.feed(chunk)
        assert len(stream._buffer) < oi.frame_size([7, 43, 44])
        assert len(listener._buffer) < 2 + 255 * 2 + 1


def test_a_million_bytes_of_noise_hold_no_frame():
    noise = np.random.default_rng(3).integers(0, 256, 1_000_000, dtype=np.uint8).tobytes()
    parser = StreamParser([7, 9, 35, 43, 44])
    assert parser.feed(noise) == []
    assert parser.header_summed is None


@pytest.mark.parametrize("summed", [True, False])
def test_a_bad_frame_makes_the_parser_learn_its_checksum_anew(summed):
    good = oi.encode_frame([Packet.MODE], {Packet.MODE: 1}, header_summed=summed)
    bad = good[:-1] + bytes([good[-1] ^ 1])
    parser = oi.StreamParser([Packet.MODE])
    for data in (good, good, bad, good, good):
        assert parser.feed(data) == []
        assert parser.header_summed is None
    assert parser.feed(good) == []
    assert parser.header_summed is summed
    assert parser.feed(good) == [{Packet.MODE: 1}]
