"""From capsules to beams: angles by the turn, of which one may be damaged in spite of its check."""

import math

import numpy as np
import pytest

from scan3d_twin.devices.rplidar.capsules import TURN_UNITS, Capsule, encode_express
from scan3d_twin.devices.rplidar.model import A1, EXPRESS, SAMPLES
from scan3d_twin.devices.rplidar.samples import CapsuleStream

MODE = A1.modes[EXPRESS]
COUNT = SAMPLES[MODE.reply]
STEP = COUNT * MODE.sample_us * 1e-6 * A1.turns * TURN_UNITS


def capsule(number, off=0.0):
    """Return capsule ``number`` of an even turn, whose angle is ``off`` [deg]."""
    start = round(number * STEP + 64 * off) % TURN_UNITS
    return encode_express(Capsule(start, (2000,) * COUNT, (0,) * COUNT))


def read(capsules):
    """Return the beams of ``capsules`` {number: bytes}, each arriving in time, and the stream."""
    stream, parts = CapsuleStream(A1, MODE), []
    for number, data in capsules.items():
        parts.append(stream.feed(data, (number + 1) * COUNT * MODE.sample_us * 1e-6))
    return parts, stream


def errors(parts):
    """Return by how much the angles of beams are off the even turn [deg]."""
    times = np.concatenate([part.times for part in parts])
    angles = np.concatenate([part.elevations for part in parts])
    off = angles - times * A1.turns * math.tau
    off -= off[0]
    return np.degrees((off + math.pi) % math.tau - math.pi)


@pytest.mark.parametrize("off", [-5.0, -1.7, 1.7, 3.0, 90.0])
@pytest.mark.parametrize("damaged", [(), (39,), (41,), (39, 41)])
def test_a_damaged_start_angle_costs_its_own_capsule_and_moves_no_other(off, damaged):
    sent = {k: capsule(k) for k in range(80)}
    sent |= {k: sent[k][:-1] + b"\x55" for k in damaged}
    undamaged, _ = read(sent)
    parts, stream = read({**sent, 40: capsule(40, off)})
    # The turn over two capsules may change by 8 %: by half of that the one before is stretched
    stretched = abs(off) / 2 if 39 in damaged and abs(off) < 0.08 * STEP / 64 else 0.0
    assert np.abs(errors(parts)).max() < 0.2 + stretched
    lost = sum(map(len, undamaged)) - sum(map(len, parts))
    assert lost == COUNT
    assert stream.bad == 1 + len(damaged)


def test_a_series_that_begins_anew_at_the_same_speed_goes_on():
    parts, _ = read({k: capsule(k, 100.0 if k >= 40 else 0.0) for k in range(80)})
    ends = np.concatenate([part.elevations for part in parts[-20:]])
    times = np.concatenate([part.times for part in parts[-20:]])
    off = ends - times * A1.turns * math.tau
    assert np.ptp(np.unwrap(off)) < math.radians(0.2)


def test_another_speed_is_found_after_a_while():
    faster = 1.3
    angles = np.cumsum([1.0] * 40 + [faster] * 60)
    sent = {k: capsule(float(angle)) for k, angle in enumerate(angles)}
    parts, _ = read(sent)
    last = parts[-1]
    speed = np.ptp(np.unwrap(last.elevations)) / np.ptp(last.times) / math.tau / A1.turns
    assert speed == pytest.approx(faster, rel=0.01)
