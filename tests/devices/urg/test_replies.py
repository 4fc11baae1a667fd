"""Replies of SCIP; quoted lines are from the SCIP 2.0 specification and the sensor's data sheet."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg import replies
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.replies import Reply, Scan, Splitter

PP = (
    b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\n"
    b"ARES:1024;\\\nAMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n"
)
VALUES = {
    "MODL": "URG-04LX(Hokuyo Automatic Co.,Ltd.)",
    **{"DMIN": "20", "DMAX": "5600", "ARES": "1024", "AMIN": "44", "AMAX": "725"},
    **{"AFRT": "384", "SCAN": "600"},
}


def reply_to(data):
    (block,) = Splitter().feed(data)
    return replies.decode_reply(block)


def test_parameters_both_ways():
    assert replies.decode_texts(reply_to(PP)) == VALUES
    lines = [replies.encode_text(*item) for item in VALUES.items()]
    assert replies.encode_reply("PP", "00", lines) == PP


@pytest.mark.parametrize(
    ("data", "echo", "status"),
    [
        (b"BM\n02R\n\n", "BM", "02"),
        (b"CR00\n03S\n\n", "CR00", "03"),
        (b"QT\n0Ee\n\n", "QT", "0E"),
        (b"SS115200;hello\n00P\n\n", "SS115200;hello", "00"),
    ],
)
def test_short_replies_both_ways(data, echo, status):
    assert reply_to(data) == Reply(echo, status)
    assert replies.encode_reply(echo, status) == data


@pytest.mark.parametrize(("data", "status"), [(b"QT\nE\n\n", "E"), (b"SCIP2.0\n0\n\n", "0")])
def test_replies_of_scip_1_1_both_ways(data, status):
    (block,) = Splitter().feed(data)
    echo = data.split(b"\n")[0].decode()
    assert replies.decode_old_reply(block) == (echo, status, ())
    assert replies.encode_old_reply(echo, status) == data
    with pytest.raises(ProtocolError, match=r"SCIP 2\.0"):
        replies.decode_reply(block)


def test_a_scan_of_the_specification():
    # A time of 16000000 ms, then 1Dh = 5432 mm over and over: 66 characters straddle two lines.
    request = ScanRequest("GD", 0, 21)
    data = (
        b"GD0000002101\n00P\nm2@0?\n"
        b"1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1Dh1B\nDh\\\n\n"
    )
    assert replies.decode_scan(reply_to(data), request) == Scan(16_000_000, [5432] * 22)
    lines = replies.encode_scan(Scan(16_000_000, [5432] * 22), 3)
    assert replies.encode_reply("GD0000002101", "00", lines) == data


@pytest.mark.parametrize(
    ("request_", "length"),
    [
        # Whole replies to the whole scan, counted on the wire.
        (ScanRequest("MD", 44, 725), 2137),
        (ScanRequest("GD", 44, 725), 2134),
        (ScanRequest("MS", 44, 725), 1435),
        (ScanRequest("MD", 44, 725, 2), 1082),
    ],
)
def test_length_of_a_scan(request_, length):
    assert replies.scan_length(request_) == length
    scan = Scan(0, [0] * request_.n_values)
    sent = replies.encode_reply(request_.request().echo, "99", replies.encode_scan(scan, 3))
    assert len(sent) == length or request_.width == 2


REQUESTS = st.builds(
    lambda command, first, steps, cluster: ScanRequest(command, first, first + steps, cluster),
    st.sampled_from(["GD", "GS", "MD", "MS"]),
    st.integers(0, 300),
    st.integers(0, 120),
    st.integers(1, 5),
)


@st.composite
def scans(draw):
    request = draw(REQUESTS)
    n = request.n_values
    values = draw(st.lists(st.integers(0, 4095), min_size=n, max_size=n))
    return request, Scan(draw(st.integers(0, 2**24 - 1)), values)


def sent(request, scan):
    lines = replies.encode_scan(scan, request.width)
    return replies.encode_reply(request.request().echo, "99", lines)


@settings(max_examples=50)
@given(st.lists(scans(), max_size=4), st.data())
def test_replies_survive_any_cut(items, data):
    stream = b"".join(sent(*item) for item in items)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    splitter, blocks = Splitter(), []
    for start, stop in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        blocks += splitter.feed(stream[start:stop])
    assert len(blocks) == len(items)
    for block, (request, scan) in zip(blocks, items, strict=True):
        reply = replies.decode_reply(block)
        assert (reply.echo, reply.status) == (request.request().echo, "99")
        assert replies.decode_scan(reply, request) == scan


@settings(max_examples=200)
@given(scans(), st.data())
def test_a_scan_with_a_flipped_bit_is_never_accepted(item, data):
    request, scan = item
    good = sent(request, scan)
    bad = bytearray(good)
    bad[data.draw(st.integers(0, len(bad) - 3))] ^= 1 << data.draw(st.integers(0, 7))
    accepted = []
    for block in Splitter().feed(bytes(bad)):
        try:
            reply = replies.decode_reply(block)
            found = replies.decode_scan(reply, request)
        except ProtocolError:
            continue
        if reply.echo == request.request().echo and reply.status == "99":
            accepted.append(found)
    assert accepted == []


@given(st.binary(max_size=600))
def test_any_garbage_is_accepted_or_a_protocol_error(data):
    request = ScanRequest("MD", 0, 9)
    readers = (
        lambda block: replies.decode_texts(replies.decode_reply(block)),
        lambda block: replies.salvage_texts(replies.decode_reply(block)),
        lambda block: replies.decode_time(replies.decode_reply(block)),
        lambda block: replies.decode_scan(replies.decode_reply(block), request),
        lambda block: replies.decode_old_scan(replies.decode_old_reply(block)[2]),
    )
    messages = []
    for block in Splitter().feed(data.replace(b"\x00", b"\n") + b"\n00P\n\n"):
        for read in readers:
            try:
                read(block)
            except ProtocolError as error:
                messages.append(str(error))
    assert "\n" not in "".join(messages)


def test_memory_is_bounded_whatever_comes():
    splitter = Splitter()
    assert splitter.feed(b"x" * 100_000) == []
    assert splitter.feed(b"y\n" * 100_000) == []
    (block,) = splitter.feed(b"z\n\n")
    assert block[-1] == b"z"
    assert len(block) == replies.MAX_LINES
    assert max(map(len, block)) <= replies.MAX_LINE


def test_a_long_line_in_pieces_is_bounded():
    splitter = Splitter()
    for _ in range(100):
        splitter.feed(b"x" * 100)
    (block,) = splitter.feed(b"\n\n")
    assert len(block[0]) == replies.MAX_LINE


def test_reset_forgets_what_was_cut_off():
    splitter = Splitter()
    splitter.feed(b"half a line\nand")
    splitter.reset()
    assert splitter.feed(b"QT\n00P\n\n") == [(b"QT", b"00P")]


def test_whether_a_block_has_begun_and_its_lines_so_far():
    splitter = Splitter()
    assert splitter.is_empty
    splitter.feed(b"Q")
    assert not splitter.is_empty
    splitter.feed(b"T\n")
    assert not splitter.is_empty
    assert splitter.lines == (b"QT",)
    splitter.feed(b"\n")
    assert splitter.is_empty
    assert splitter.lines == ()


def test_a_full_line_of_data_is_told_from_garbage():
    line = replies.encode_scan(Scan(0, [5432] * 22), 3)[1]
    assert replies.is_data(line)
    assert not replies.is_data(line[:-1])
    assert not replies.is_data(line + b"0")
    assert not replies.is_data(line[1:] + line[:1])
    assert not replies.is_data(b"\x0c" + line[1:])
    assert not replies.is_data(b"")


@pytest.mark.parametrize(("steps", "rest"), [(43, 1), (64, 64), (22, 2)])
def test_the_last_line_may_have_any_length(steps, rest):
    request = ScanRequest("GD", 0, steps - 1)
    scan = Scan(1, list(range(1000, 1000 + steps)))
    lines = replies.encode_scan(scan, 3)
    assert len(lines[-1]) == rest + 1
    assert replies.decode_scan(Reply("", "00", tuple(lines)), request) == scan


def test_an_echo_is_found_wherever_it_is():
    assert replies.find_echo((b"QT",), "QT") == (b"QT",)
    assert replies.find_echo((b"QT", b"x"), "QT") == (b"QT", b"x")
    assert replies.find_echo((b"x", b"QT"), "QT") == (b"QT",)
    assert replies.find_echo((b"x",), "QT") == ()
    assert replies.find_echo((), "QT") == ()


def test_the_reply_begins_at_the_last_echo():
    block = (b"rest", b"MD0044072501000", b"99b", b"MD0044072501000", b"99b", b"data")
    assert replies.find_echo(block, "MD0044072501000") == block[3:]
    assert replies.find_echo(block, "QT") == ()


def test_good_lines_of_a_faulty_version():
    data = b"VV\n00P\nPROT:SCIP 2.0;N\nI\nSERI:H0706400;G\n\n"
    with pytest.raises(ProtocolError, match="bad line b'I'"):
        replies.decode_texts(reply_to(data))
    assert replies.salvage_texts(reply_to(data)) == {"PROT": "SCIP 2.0"}


@pytest.mark.parametrize(
    "line",
    [b"", b";", b"PROT:SCIP 2.0;M", b"PROT:SCIP 2.0N", b":x;b", b"A\x01:1;]", b"AB;3", b"A:\xe9;T"],
)
def test_lines_of_text_that_are_bad(line):
    with pytest.raises(ProtocolError):
        replies.decode_text(line)


def test_the_time_of_tm1():
    assert replies.decode_time(reply_to(b"TM1\n00P\nm2@0?\n\n")) == 16_000_000
    for bad in (b"TM1\n00P\n\n", b"TM1\n00P\nm2@0>\n\n", b"TM1\n00P\nm2@?\n\n"):
        with pytest.raises(ProtocolError):
            replies.decode_time(reply_to(bad))


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ((), "no time"),
        ((b"m2@0?",), "0 values instead of 22"),
        ((b"m2@0?", b"1DhM", b"1DhM"), "64 characters"),
        ((b"m2@0?", b"1DhL"), "wrong checksum"),
        ((b"2@0R", b"1DhM"), "no time"),
    ],
)
def test_scans_that_are_bad(lines, why):
    with pytest.raises(ProtocolError, match=why):
        replies.decode_scan(Reply("GD0000002101", "00", lines), ScanRequest("GD", 0, 21))


@given(st.lists(st.integers(0, 4095), max_size=100))
def test_scans_of_scip_1_1_both_ways(values):
    data = replies.encode_old_reply("G04472501", "0", replies.encode_old_scan(values))
    (block,) = Splitter().feed(data)
    assert replies.decode_old_scan(replies.decode_old_reply(block)[2]) == values
    assert all(len(line) <= 64 for line in block)
