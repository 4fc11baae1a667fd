"""Readings are accepted at once on a clean link and debounced on a noisy one."""

from scan3d_twin.devices.create.codec import CREATE2
from scan3d_twin.devices.create.driving.reading_filter import NOISY_TIME, ReadingFilter
from scan3d_twin.devices.create.link import Contact
from scan3d_twin.devices.create.packets import Packet

QUIET = {Packet.BUMPS_DROPS: 0, Packet.LEFT_COUNTS: 5}
BUMPED = {Packet.BUMPS_DROPS: 2, Packet.LEFT_COUNTS: 9}


def doubting(at=10.0):
    reading_filter = ReadingFilter()
    reading_filter.take(QUIET, at - 1)
    assert reading_filter.count_errors(1, at)
    return reading_filter


def test_on_a_good_line_all_is_believed_at_once():
    reading_filter = ReadingFilter()
    assert not reading_filter.count_errors(0, 1.0)
    assert reading_filter.take(QUIET, 1.0) == QUIET
    assert reading_filter.take(BUMPED, 1.015) == BUMPED


def test_in_doubt_only_what_is_read_twice_is_believed():
    reading_filter = doubting()
    assert reading_filter.take(BUMPED, 10.0) == QUIET | {Packet.LEFT_COUNTS: 9}
    assert reading_filter.take(QUIET, 10.015)[Packet.BUMPS_DROPS] == 0
    assert reading_filter.take(BUMPED, 10.03)[Packet.BUMPS_DROPS] == 0
    assert reading_filter.take(BUMPED, 10.045)[Packet.BUMPS_DROPS] == 2


def test_the_first_readings_are_all_there_is():
    reading_filter = ReadingFilter()
    reading_filter.count_errors(3, 1.0)
    assert reading_filter.take(BUMPED, 1.0) == BUMPED


def test_a_packet_that_is_new_is_believed():
    # At rest more packets are requested from a Create 1.
    reading_filter = doubting()
    assert reading_filter.take({**QUIET, Packet.VOLTAGE: 15_000}, 10.0)[Packet.VOLTAGE] == 15_000


def test_doubt_passes_and_comes_back_with_more_broken_bytes():
    reading_filter = doubting()
    assert reading_filter.is_noisy(10.0 + 0.99 * NOISY_TIME)
    assert not reading_filter.is_noisy(10.0 + 1.01 * NOISY_TIME)
    assert not reading_filter.count_errors(1, 20.0)
    assert not reading_filter.is_noisy(20.0)
    assert reading_filter.count_errors(2, 30.0)
    assert reading_filter.is_noisy(30.5)


def test_a_stream_that_was_asked_for_anew_counts_from_zero():
    reading_filter = doubting()
    assert not reading_filter.count_errors(0, 20.0)
    assert reading_filter.count_errors(1, 30.0)


def test_the_first_readings_are_not_believed_with_one_out_of_range():
    contact, odd = Contact(CREATE2, 115200, 0), {**BUMPED, Packet.BUMPS_DROPS: 96 + 2}
    reading_filter = ReadingFilter()
    assert reading_filter.mask(odd, contact, 1.0) is None
    assert reading_filter.mask(QUIET, contact, 1.015) == QUIET
    assert reading_filter.take(QUIET, 1.015) == QUIET
    # On a good line that is known, or twice in a row, it is what the base sends
    assert reading_filter.mask(odd, contact, 1.03) == BUMPED
    fresh = ReadingFilter()
    assert fresh.mask(odd, contact, 1.0) is None
    assert fresh.mask(odd, contact, 1.015) == BUMPED
