"""What was read once is believed on a good line, and held back on one that garbles bytes."""

from scan3d_twin.devices.create.packets import Packet
from scan3d_twin.devices.create.reading_filter import DOUBT, ReadingFilter

QUIET = {Packet.BUMPS_DROPS: 0, Packet.LEFT_COUNTS: 5}
BUMPED = {Packet.BUMPS_DROPS: 2, Packet.LEFT_COUNTS: 9}


def doubting(at=10.0):
    sieve = ReadingFilter()
    sieve.take(QUIET, at - 1)
    assert sieve.line(1, at)
    return sieve


def test_on_a_good_line_all_is_believed_at_once():
    sieve = ReadingFilter()
    assert not sieve.line(0, 1.0)
    assert sieve.take(QUIET, 1.0) == QUIET
    assert sieve.take(BUMPED, 1.015) == BUMPED


def test_in_doubt_only_what_is_read_twice_is_believed():
    sieve = doubting()
    assert sieve.take(BUMPED, 10.0) == QUIET | {Packet.LEFT_COUNTS: 9}
    assert sieve.take(QUIET, 10.015)[Packet.BUMPS_DROPS] == 0
    assert sieve.take(BUMPED, 10.03)[Packet.BUMPS_DROPS] == 0
    assert sieve.take(BUMPED, 10.045)[Packet.BUMPS_DROPS] == 2


def test_the_first_readings_are_all_there_is():
    sieve = ReadingFilter()
    sieve.line(3, 1.0)
    assert sieve.take(BUMPED, 1.0) == BUMPED


def test_a_packet_that_is_new_is_believed():
    # At rest a Create 1 is asked for more packets.
    sieve = doubting()
    assert sieve.take({**QUIET, Packet.VOLTAGE: 15_000}, 10.0)[Packet.VOLTAGE] == 15_000


def test_doubt_passes_and_comes_back_with_more_broken_bytes():
    sieve = doubting()
    assert sieve.doubts(10.0 + 0.99 * DOUBT)
    assert not sieve.doubts(10.0 + 1.01 * DOUBT)
    assert not sieve.line(1, 20.0)
    assert not sieve.doubts(20.0)
    assert sieve.line(2, 30.0)
    assert sieve.doubts(30.5)


def test_a_stream_that_was_asked_for_anew_counts_from_zero():
    sieve = doubting()
    assert not sieve.line(0, 20.0)
    assert sieve.line(1, 30.0)
