"""Requests and single replies of the RPLIDAR; bytes that the maker's SDK and pyrplidar accept."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.codec import (
    Command,
    ConfKey,
    Descriptor,
    DeviceInfo,
    Health,
    ReplyType,
    Request,
    RequestSplitter,
    SampleRate,
)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        (codec.encode_request(Command.STOP), "A5 25"),
        (codec.encode_request(Command.RESET), "A5 40"),
        (codec.encode_request(Command.SCAN), "A5 20"),
        (codec.encode_request(Command.GET_INFO), "A5 50"),
        (codec.encode_express_scan(0), "A5 82 05 00 00 00 00 00 22"),
        (codec.encode_express_scan(1), "A5 82 05 01 00 00 00 00 23"),
        (codec.encode_conf_request(ConfKey.TYPICAL_MODE), "A5 84 04 7C 00 00 00 59"),
        (codec.encode_conf_request(ConfKey.MODE_US_PER_SAMPLE, 1), "A5 84 06 71 00 00 00 01 00 57"),
        (codec.encode_motor_rpm(600), "A5 A8 02 58 02 55"),
        (codec.encode_motor_rpm(0), "A5 A8 02 00 00 0F"),
        (codec.encode_request(Command.SET_MOTOR_PWM, b"\x94\x02"), "A5 F0 02 94 02 C1"),
        (codec.encode_request(Command.GET_ACC_BOARD_FLAG, bytes(4)), "A5 FF 04 00 00 00 00 5E"),
    ],
)
def test_requests(request_, expected):
    assert request_ == bytes.fromhex(expected)


@pytest.mark.parametrize(
    ("descriptor", "expected"),
    [
        (Descriptor(5, True, ReplyType.NODES), "A5 5A 05 00 00 40 81"),
        (Descriptor(20, False, ReplyType.INFO), "A5 5A 14 00 00 00 04"),
        (Descriptor(3, False, ReplyType.HEALTH), "A5 5A 03 00 00 00 06"),
        (Descriptor(4, False, ReplyType.SAMPLERATE), "A5 5A 04 00 00 00 15"),
        (Descriptor(84, True, ReplyType.EXPRESS), "A5 5A 54 00 00 40 82"),
        (Descriptor(84, True, ReplyType.DENSE), "A5 5A 54 00 00 40 85"),
        (Descriptor(4, False, ReplyType.ACC_BOARD_FLAG), "A5 5A 04 00 00 00 FF"),
    ],
)
def test_descriptors(descriptor, expected):
    assert descriptor.encode() == bytes.fromhex(expected)
    assert codec.decode_descriptor(bytes.fromhex(expected)) == descriptor


@pytest.mark.parametrize(
    "bad", ["A5 5A 05 00 00 40", "A5 5B 05 00 00 40 81", "A5 5A 05 00 00 80 81"]
)
def test_what_is_no_descriptor_is_refused(bad):
    with pytest.raises(ProtocolError):
        codec.decode_descriptor(bytes.fromhex(bad))


def test_an_entry_of_the_configuration():
    reply = bytes.fromhex("A5 5A 08 00 00 00 20 71 00 00 00 00 C8 00 00")
    value = (200 * codec.FIXED_POINT).to_bytes(4, "little")
    payload = codec.encode_conf_reply(ConfKey.MODE_US_PER_SAMPLE, value)
    assert codec.encode_reply(ReplyType.LIDAR_CONF, payload) == reply
    assert codec.decode_number(codec.decode_conf_reply(payload, 0x71)) == 200 * 256
    with pytest.raises(ProtocolError, match="not the entry"):
        codec.decode_conf_reply(payload, 0x74)
    assert codec.decode_conf_request(bytes.fromhex("71 00 00 00 01 00")) == (0x71, 1)
    assert codec.decode_conf_request(bytes.fromhex("7C 00 00 00")) == (0x7C, 0)
    assert codec.decode_name(b"Standard\0\xff") == "Standard"
    for refuse in (
        lambda: codec.decode_number(b"\0" * 3),
        lambda: codec.decode_name(b"\x01"),
        lambda: codec.decode_conf_request(b"\x71"),
    ):
        with pytest.raises(ProtocolError):
            refuse()


def test_single_replies():
    info = DeviceInfo(0x41, (1, 2), 18, bytes(range(16)))
    assert info.encode() == bytes([0x41, 2, 1, 18, *range(16)])
    assert codec.decode_info(info.encode()) == info
    assert info.major_id == 4
    assert Health(1, 0x1234).encode() == bytes.fromhex("01 34 12")
    assert codec.decode_health(bytes.fromhex("01 34 12")) == Health(1, 0x1234)
    assert codec.decode_sample_rate(SampleRate(508, 254).encode()) == SampleRate(508, 254)
    for refuse in (
        lambda: codec.decode_info(bytes(19)),
        lambda: codec.decode_health(bytes.fromhex("03 00 00")),
        lambda: codec.decode_sample_rate(bytes(4)),
    ):
        with pytest.raises(ProtocolError):
            refuse()


REQUESTS = [
    Request(Command.STOP),
    Request(Command.EXPRESS_SCAN, bytes([1, 0, 0, 0, 0])),
    Request(Command.GET_INFO),
    Request(Command.SET_MOTOR_RPM, b"\xa5\x25"),
    Request(Command.GET_LIDAR_CONF, b"\x71\0\0\0\1\0"),
]


@given(st.lists(st.integers(1, 9), min_size=1), st.binary(max_size=8))
def test_requests_are_found_wherever_the_bytes_are_cut(sizes, junk):
    junk = junk.replace(b"\xa5", b"")
    data = junk + b"".join(codec.encode_request(r.command, r.payload) + junk for r in REQUESTS)
    splitter, found = RequestSplitter(), []
    while data:
        size = sizes[len(found) % len(sizes)]
        found += splitter.feed(data[:size])
        data = data[size:]
    assert found == REQUESTS
    assert splitter.bad == 0


def test_a_request_with_a_wrong_checksum_is_dropped_and_counted():
    splitter = RequestSplitter()
    data = bytearray(codec.encode_express_scan(1))
    data[-1] ^= 4
    assert splitter.feed(bytes(data) + codec.encode_request(Command.STOP)) == [REQUESTS[0]]
    assert splitter.bad == 1
