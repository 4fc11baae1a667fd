"""Numbers, checksums and requests; quoted values are from the SCIP 2.0 specification."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg.codec import Request, RequestError, ScanRequest


@pytest.mark.parametrize(
    ("value", "text"), [(1234, b"CB"), (5432, b"1Dh"), (16000000, b"m2@0"), (0, b"00")]
)
def test_values_of_the_specification(value, text):
    assert scip.encode_value(value, len(text)) == text
    assert scip.decode_values(text, len(text)) == [value]


def test_the_largest_value_of_two_characters():
    assert scip.encode_value(4095, 2) == b"oo"
    with pytest.raises(ProtocolError, match="4096"):
        scip.encode_value(4096, 2)
    with pytest.raises(ProtocolError):
        scip.encode_value(-1, 2)


@pytest.mark.parametrize(
    ("status", "character"),
    [
        *[("00", "P"), ("99", "b"), ("98", "a"), ("01", "Q"), ("02", "R"), ("03", "S")],
        *[("04", "T"), ("05", "U"), ("06", "V"), ("07", "W"), ("10", "Q"), ("21", "S")],
        *[("50", "U"), ("0A", "a"), ("0E", "e"), ("0I", "i")],
    ],
)
def test_sum_of_a_status(status, character):
    assert chr(scip.checksum(status.encode())) == character


@pytest.mark.parametrize(
    ("text", "character"),
    [
        ("VEND:Hokuyo Automatic Co.,Ltd.", "["),
        ("PROT:SCIP 2.0", "N"),
        ("DMAX:5600", "_"),
        ("ARES:1024", "\\"),
        ("AMAX:725", "o"),
        ("SCAN:600", "e"),
        ("JUGn", "D"),
    ],
)
def test_sum_of_a_line(text, character):
    assert chr(scip.checksum(text.encode())) == character


@given(st.lists(st.integers(0, 4095)), st.sampled_from([2, 3, 4]))
def test_values_come_back(values, width):
    data = b"".join(scip.encode_value(value, width) for value in values)
    assert scip.decode_values(data, width) == values


@given(st.binary(max_size=40), st.sampled_from([2, 3, 4]))
def test_any_characters_are_values_or_an_error(data, width):
    try:
        values = scip.decode_values(data, width)
    except ProtocolError:
        return
    assert b"".join(scip.encode_value(value, width) for value in values) == data


@given(st.binary(min_size=1, max_size=65).map(lambda b: bytes(0x30 + x % 64 for x in b)), st.data())
def test_sum_and_alphabet_see_every_flipped_bit(line, data):
    whole = line + bytes([scip.checksum(line)])
    place = data.draw(st.integers(0, len(whole) - 1))
    bit = data.draw(st.integers(0, 7))
    bad = bytearray(whole)
    bad[place] ^= 1 << bit
    assert not scip.is_sixbit(bad[:-1]) or bad[-1] != scip.checksum(bytes(bad[:-1]))


@pytest.mark.parametrize(
    ("request_", "line"),
    [
        (ScanRequest("GD", 44, 725).request(), b"GD0044072501\n"),
        (ScanRequest("MD", 44, 725).request(), b"MD0044072501000\n"),
        (ScanRequest("MS", 0, 768, 99, 9, 99).request(), b"MS0000076899999\n"),
        (ScanRequest("MD", 44, 725, count=3).request(remaining=2), b"MD0044072501002\n"),
        (Request("SS", "115200"), b"SS115200\n"),
        (Request("VV", tag="first try"), b"VV;first try\n"),
    ],
)
def test_request_lines(request_, line):
    assert request_.encode() == line
    assert scip.parse_request(line[:-1]) == request_


@pytest.mark.parametrize(
    ("line", "status"),
    [
        *[(b"V", "0D"), (b"ME0044072501000", "0E"), (b"%ST", "0E"), (b"vv", "0E")],
        *[(b"TM", "0C"), (b"GD00440725", "0C"), (b"VV1", "0F"), (b"GD00440725010", "0F")],
        *[(b"VV;12345678901234567", "0G"), (b"VV;?", "0H"), (b"VV;a;b", "0H"), (b"", "0D")],
        (b"\xff\x80", "0E"),
    ],
)
def test_requests_that_are_refused(line, status):
    with pytest.raises(RequestError) as caught:
        scip.parse_request(line)
    assert caught.value.status == status


def test_a_tag_of_sixteen_characters_is_allowed():
    tag = "0123456789 ._+@a"
    assert scip.parse_request(b"QT;" + tag.encode()).tag == tag


@pytest.mark.parametrize(
    ("line", "status"),
    [
        *[(b"GD00x4072501", "01"), (b"GD0044x72501", "02"), (b"GD00440725 1", "03")],
        *[(b"MD0044072601000", "04"), (b"MD0045004401000", "05")],
        *[(b"MD0044072501x00", "06"), (b"MD00440725010-1", "07")],
    ],
)
def test_scan_requests_that_are_refused(line, status):
    request = scip.parse_request(line)
    with pytest.raises(RequestError) as caught:
        scip.parse_scan_request(request, last_step=725)
    assert caught.value.status == status


def test_constants_of_the_specification():
    assert scip.BAUDS == (19200, 38400, 57600, 115200, 250000, 500000, 750000)
    # 16777215 ms are 4.66 hours.
    assert (1 << scip.TIMER_BITS) - 1 == 16777215
    assert set(scip.COMMANDS) == {
        *("VV", "PP", "II", "BM", "QT", "RS", "TM", "SS", "CR", "HS", "DB", "GD", "GS", "MD", "MS")
    }


@pytest.mark.parametrize(
    "line",
    [
        *[b"VV", b"PP", b"II", b"BM", b"QT", b"RS", b"TM0", b"SS019200", b"CR00", b"HS0", b"DB01"],
        *[b"GD0044072501", b"GS0044072501", b"MD0044072501000", b"MS0044072501000"],
    ],
)
def test_each_command_takes_its_parameters_no_more_and_no_fewer(line):
    assert scip.parse_request(line).encode() == line + b"\n"
    with pytest.raises(RequestError) as caught:
        scip.parse_request(line + b"0")
    assert caught.value.status == "0F"
    if len(line) > 2:
        with pytest.raises(RequestError) as caught:
            scip.parse_request(line[:-1])
        assert caught.value.status == "0C"


def test_the_last_step_may_be_asked_for():
    assert scip.parse_scan_request(scip.parse_request(b"GD0725072501"), 725).last == 725


def test_requests_are_values():
    scan = ScanRequest("GD", 44, 725)
    assert scan.cluster == scip.OldScanRequest(44, 725).cluster == 1
    assert scan == ScanRequest("GD", 44, 725)
    assert (
        len({scan, scan.request(), scip.OldScanRequest(44, 725), ScanRequest("GD", 44, 725)}) == 3
    )


SCANS = st.builds(
    lambda command, a, b, cluster, skip, count, tag: ScanRequest(
        command, min(a, b), max(a, b), cluster, *((skip, count) if command < "N" else (0, 0)), tag
    ),
    st.sampled_from(["MD", "MS"]),
    st.integers(0, 768),
    st.integers(0, 768),
    st.integers(0, 99),
    st.integers(0, 9),
    st.integers(0, 99),
    st.text(sorted(scip.TAG_CHARACTERS), max_size=16),
)


@given(SCANS)
def test_scan_requests_come_back(scan):
    line = scan.request().encode()[:-1]
    assert scip.parse_scan_request(scip.parse_request(line), 768) == scan


@pytest.mark.parametrize(
    ("scan", "width", "n_values", "is_stream"),
    [
        (ScanRequest("GD", 44, 725), 3, 682, False),
        (ScanRequest("GS", 44, 725, 2), 2, 341, False),
        (ScanRequest("MD", 0, 9, 3), 3, 4, True),
        (ScanRequest("MS", 384, 384, 0), 2, 1, True),
    ],
)
def test_what_a_scan_request_asks_for(scan, width, n_values, is_stream):
    assert (scan.width, scan.n_values, scan.is_stream) == (width, n_values, is_stream)


@given(st.binary(max_size=40))
def test_any_line_is_a_request_or_refused(line):
    try:
        request = scip.parse_request(line)
        if request.command in ("GD", "GS", "MD", "MS"):
            scip.parse_scan_request(request, 725)
    except RequestError:
        return
    assert request.encode() == line + b"\n"


def test_the_scan_request_of_scip_1_1():
    scan = scip.parse_old_scan_request(b"G04472501", 725)
    assert (scan.first, scan.last, scan.cluster) == (44, 725, 1)
    assert scan.echo == "G04472501"


def test_one_step_may_be_asked_for_in_scip_1_1():
    scan = scip.parse_old_scan_request(b"G72572599", 725)
    assert (scan.first, scan.last, scan.cluster) == (725, 725, 99)


@pytest.mark.parametrize(
    "line", [b"G0447250", b"G04472601", b"G72504401", b"X04472501", b"", b"G0447250\xb2"]
)
def test_scan_requests_of_scip_1_1_that_are_refused(line):
    with pytest.raises(RequestError) as caught:
        scip.parse_old_scan_request(line, 725)
    assert caught.value.status == "E"


@pytest.mark.parametrize("width", [2, 3, 4])
def test_the_largest_value_fits_and_the_next_does_not(width):
    largest = 64**width - 1
    assert scip.decode_values(scip.encode_value(largest, width), width) == [largest]
    with pytest.raises(ProtocolError, match=f"{largest + 1} does not fit into {width} characters"):
        scip.encode_value(largest + 1, width)
