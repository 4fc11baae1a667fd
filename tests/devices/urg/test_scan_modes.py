"""Which scans fit which bit rate; the numbers are those of the bytes on the wire, 8N1."""

import pytest

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.urg import scan_modes as urg_mode
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.model import LINKS, ScanMode


@pytest.mark.parametrize(
    ("request_", "baud", "milliseconds"),
    [
        (ScanRequest("MD", 44, 725), 19200, 1113),
        (ScanRequest("MD", 44, 725), 57600, 371),
        (ScanRequest("MD", 44, 725), 115200, 186),
        (ScanRequest("MD", 44, 725), 250000, 85),
        (ScanRequest("MD", 44, 725), 500000, 43),
        (ScanRequest("MD", 44, 725), 750000, 28),
        (ScanRequest("MS", 44, 725), 115200, 125),
        (ScanRequest("MD", 44, 725, 2), 115200, 94),
    ],
)
def test_how_long_a_scan_takes(request_, baud, milliseconds):
    assert 1e3 * urg_mode.duration(request_, baud) == pytest.approx(milliseconds, abs=0.6)


@pytest.mark.parametrize(
    ("link", "current", "command", "baud"),
    [
        ("usb", 115200, "MD", 250000),
        ("usb", 500000, "MD", 500000),
        ("115200", 115200, "MD", 115200),
        ("115200", 19200, "MD", 115200),
        ("115200-full", 19200, "MD", 115200),
        ("115200-full", 57600, "MD", 115200),
    ],
)
def test_the_first_choice(link, current, command, baud):
    requests = urg_mode.scan_requests(LINKS[link])
    request, chosen = next(urg_mode.choices(requests, current))
    assert (request.command, chosen) == (command, baud)


@pytest.mark.parametrize(("steps", "command"), [(357, "MD"), (364, "MS"), (536, "MS"), (547, None)])
def test_how_many_steps_fit_115200_baud_at_10_hz(steps, command):
    requests = urg_mode.scan_requests(ScanMode(44, 43 + steps, 1), cluster=1)
    fit = [r.command for r, baud in urg_mode.choices(requests, 115200) if baud == 115200]
    assert fit[:1] == [command][: command is not None]


def test_every_second_turn_is_asked_for():
    assert (
        urg_mode.scan_requests(LINKS["115200-full"])[0].request().encode() == b"MD0044072501100\n"
    )


@pytest.mark.parametrize(("turns", "cluster"), [(1, 0), (1, 100), (0, 1), (11, 1)])
def test_what_the_sensor_does_not_know_is_refused(turns, cluster):
    with pytest.raises(ConfigError, match="cluster must be 1 to 99 and turns per line 1 to 10"):
        urg_mode.scan_requests(ScanMode(44, 725, turns), cluster)
    assert urg_mode.scan_requests(ScanMode(44, 725, 10), 99)


def test_the_refusal_names_what_would_do():
    text = str(urg_mode.too_slow(ScanRequest("MS", 44, 725), 115200))
    assert "682 steps take 125 ms at 115200 baud" in text
    assert "250000 baud" in text
    assert "547 steps" in text
    assert "every 2. turn" in text


@pytest.mark.parametrize(
    ("baud", "steps"), [(250000, 682), (115200, 363), (57600, 177), (38400, 115), (19200, 53)]
)
def test_the_widest_window_a_bit_rate_carries(baud, steps):
    mode = urg_mode.window(baud)
    assert len(mode.steps) == pytest.approx(steps, abs=3)
    assert mode.first_step + mode.last_step == 2 * 384 or steps == 682
    request = ScanRequest("MD", mode.first_step, mode.last_step)
    assert urg_mode.duration(request, baud) <= 0.1


def test_without_a_mode_all_steps_are_wanted_first_and_then_the_widest_window():
    requests = urg_mode.scan_requests(None)
    assert [(r.command, r.first, r.last) for r in requests[:2]] == [
        ("MD", 44, 725),
        ("MS", 44, 725),
    ]
    widths = [request.n_values for request in requests]
    assert widths == sorted(widths, reverse=True)
    assert min(widths) > 50
