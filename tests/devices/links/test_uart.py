"""A receiver that listens at another rate than the talker's."""

import pytest

from scan3d_twin.devices.links.uart import Uart

EVERY_BYTE = bytes(range(256))


def hear(data, sent, heard, seed=0):
    uart = Uart(seed)
    return uart.take(data, 0.0, sent, heard) + uart.idle(1e3)


@pytest.mark.parametrize("rate", [300, 19200, 115200, 1_000_000])
def test_nearly_the_same_rate_loses_nothing(rate):
    for seed in range(20):
        assert hear(EVERY_BYTE, rate, rate, seed) == EVERY_BYTE
        assert hear(EVERY_BYTE, rate, round(1.02 * rate), seed) == EVERY_BYTE


@pytest.mark.parametrize(
    ("data", "sent", "heard", "expected"),
    [
        # Low for 9 of 10 bits, each of which lasts twice as long: 0 0000 0000 1 is nearly all low
        (b"\x00", 57600, 115200, b"\x00"),
        # Low for 8 bits, high for 2: each two of them are one: 0 000 1 1111 1
        (b"\x80", 115200, 57600, b"\xf8"),
        # Low for one bit, which ends before the middle of the slow start bit
        (b"\xff", 115200, 19200, b""),
        # 0 1111 0000 1: twice as fast, the start bit is two bits long, and so is each other one
        (b"\x0f", 57600, 115200, b"\xfe\x80"),
    ],
)
def test_a_byte_at_another_rate_is_what_its_waveform_says(data, sent, heard, expected):
    for seed in range(20):
        assert hear(data, sent, heard, seed) == expected


def test_bytes_in_pieces_are_heard_like_bytes_at_once():
    data, byte = bytes(range(100)), 10 / 115200
    whole = hear(data, 115200, 40000)
    uart = Uart(0)
    parts = [uart.take(data[k : k + 1], k * byte, 115200, 40000) for k in range(100)]
    assert b"".join(parts) + uart.idle(1.0) == whole
    assert 20 < len(whole) < 50


def test_a_character_that_the_line_leaves_unfinished_ends_high():
    uart = Uart(0)
    assert uart.take(b"\x80", 0.0, 115200, 57600) == b""
    assert uart.idle(1.5 * 10 / 115200) == b""
    assert uart.idle(1.0) == b"\xf8"
    assert uart.idle(2.0) == b""


def test_a_rate_that_changes_finishes_the_character():
    uart = Uart(0)
    assert uart.take(b"\x80", 0.0, 115200, 57600) == b""
    assert uart.take(b"\x00", 10 / 115200, 57600, 115200) == b"\xf8\x00"
    assert uart.idle(1.0) == b""
