"""Salvage of garbled scans; each expectation follows from which bytes are garbled."""

import numpy as np
import pytest

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.replies import Scan, Splitter, encode_reply, encode_scan
from scan3d_twin.devices.urg.salvage import LOST, salvage_scan, split_scans

REQUEST = ScanRequest("MD", 44, 725)
ECHO = REQUEST.request().echo
VALUES = np.random.default_rng(7).integers(20, 4096, 682).tolist()
SENT = encode_reply(ECHO, "99", encode_scan(Scan(123456, VALUES), 3))
HEAD = len(ECHO) + 1 + 4 + 6
LONGEST = 5600
N_ROWS = 32


def block_of(data):
    """Return the one block in ``data``."""
    (block,) = Splitter().feed(data)
    return block


def salvaged(data):
    """Return what is left of a scan."""
    return salvage_scan(block_of(bytes(data)), REQUEST, LONGEST)


def values_without(*rows):
    """Return the values of which no character lies in one of the ``rows``."""
    lost = {i // 3 for row in rows for i in range(64 * row, 64 * row + 64)}
    return [LOST if k in lost else value for k, value in enumerate(VALUES)]


def place(row, column=0):
    """Return the index of a character in what is sent."""
    return HEAD + 66 * row + column


def test_a_whole_scan_is_left_whole():
    found = salvaged(SENT)
    assert (found.time_ms, found.values, found.lost_rows) == (123456, VALUES, 0)


@pytest.mark.parametrize("row", [0, 1, 15, N_ROWS - 2, N_ROWS - 1])
@pytest.mark.parametrize("fault", ["flip", "drop", "insert", "checksum"])
def test_a_garbled_row_costs_its_own_values(row, fault):
    data, at = bytearray(SENT), place(row, 3)
    if fault == "flip":
        data[at] ^= 4
    elif fault == "drop":
        del data[at]
    elif fault == "insert":
        data.insert(at, 0x41)
    else:
        size = 64 if row < N_ROWS - 1 else 682 * 3 - 64 * (N_ROWS - 1)
        data[place(row, size)] ^= 1
    found = salvaged(data)
    assert found.values == values_without(row)
    assert (found.time_ms, found.lost_rows) == (123456, 1)


def test_two_rows_run_together_without_a_line_feed():
    data = bytearray(SENT)
    del data[place(4, 65)]
    assert salvaged(data).values == values_without(4, 5)


def test_losses_in_many_rows_do_not_shift_the_others():
    data = bytearray(SENT)
    for row in range(20, 0, -2):
        del data[place(row, 10)]
    assert salvaged(data).values == values_without(*range(2, 21, 2))


@pytest.mark.parametrize("slip", [-66, -17, 17, 66])
def test_a_scan_whose_rows_cannot_be_told_apart_is_refused(slip):
    data = bytearray(SENT)
    if slip < 0:
        del data[place(9) : place(9) - slip]
    else:
        data[place(9) : place(9)] = data[place(9) : place(9) + slip]
    with pytest.raises(ProtocolError, match=rf"a scan with [{slip:+d}]"):
        salvaged(data)


@pytest.mark.parametrize(("at", "timed"), [(0, True), (15, True), (17, True), (19, False)])
def test_a_garbled_head_costs_no_values(at, timed):
    data = bytearray(SENT)
    data[at] = 1
    found = salvaged(data)
    assert found.values == VALUES
    assert (found.time_ms is not None) is timed


def test_other_replies_are_no_scan():
    for status in ("00", "0B", "10"):
        with pytest.raises(ProtocolError):
            salvaged(encode_reply(ECHO, status))
    with pytest.raises(ProtocolError, match="no row"):
        salvaged(SENT[:HEAD] + b"\n".join([b"x" * 65] * 31 + [b"x" * 62]) + b"\n\n")


def test_an_error_that_the_checksum_misses_is_seen_where_a_value_is_out_of_range():
    # A byte lost and the same one inserted later: the sum and the length are right
    data = bytearray(SENT)
    lost = data.pop(place(7, 6))
    data.insert(place(7, 40), lost)
    found = salvaged(data)
    assert found.values == values_without(7)
    # In a scan without any error nothing is lost with a value out of range
    values = [*VALUES[:100], 5601, *VALUES[101:]]
    sent = encode_reply(ECHO, "99", encode_scan(Scan(1, values), 3))
    assert salvaged(sent).values.count(LOST) > 0


@pytest.mark.parametrize("end", [b"\n", b"", b"\x07\n", b"\x07"])
def test_scans_that_run_together_are_split(end):
    data = SENT[:-2] + end + SENT
    parts = list(split_scans(block_of(data), ECHO))
    assert len(parts) == 2
    first, second = (salvage_scan(part, REQUEST, LONGEST) for part in parts)
    assert second.values == VALUES
    assert first.values == (values_without(N_ROWS - 1) if b"\x07" in end else VALUES)


def test_scans_that_run_together_at_a_garbled_echo_are_split():
    data = SENT[:-1] + b"?" + SENT[1:]
    first, second = split_scans(block_of(data), ECHO)
    assert salvage_scan(first, REQUEST, LONGEST).values == VALUES
    assert salvage_scan(second, REQUEST, LONGEST).values == VALUES


def test_a_reply_without_a_scan_is_one_part():
    block = block_of(encode_reply("QT", "00"))
    assert list(split_scans(block, ECHO)) == [block]


def test_wrong_values_are_rare_where_a_byte_of_300_is_garbled():
    rng, wrong, rows = np.random.default_rng(3), 0, 0
    sent = np.frombuffer(SENT, np.uint8)
    for _ in range(300):
        data = []
        for byte in sent[:-2].tolist():
            fault = rng.random()
            flipped = byte ^ 1 << int(rng.integers(8)) if fault < 1e-3 else byte
            data += [] if 1e-3 <= fault < 2e-3 else [flipped]
            data += [int(rng.integers(256))] if 2e-3 <= fault < 3e-3 else []
        for block in Splitter().feed(bytes(data) + b"\n\n"):
            try:
                found = salvage_scan(block, REQUEST, LONGEST)
            except ProtocolError:
                continue
            rows += N_ROWS - found.lost_rows
            wrong += sum(v not in (LOST, w) for v, w in zip(found.values, VALUES, strict=True)) > 0
    # Each of 64 characters and a sum arrives with probability exp(-0.195)
    assert rows > 0.75 * 300 * N_ROWS
    # Two errors cancel in the sum of 1 of 20000 rows, and no value is out of range
    assert wrong <= 2
