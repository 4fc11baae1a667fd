"""The frames of a scan: their bytes, and finding them in a damaged stream."""

import numpy as np
import pytest

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.links.line_model import Faults, Line
from scan3d_twin.devices.rplidar.capsules import (
    CAPSULE_LENGTH,
    DENSE_SAMPLES,
    EXPRESS_SAMPLES,
    Capsule,
    decode_dense,
    decode_express,
    encode_dense,
    encode_express,
    sample_angles,
)
from scan3d_twin.devices.rplidar.frames import CapsuleSplitter, NodeSplitter
from scan3d_twin.devices.rplidar.nodes import Node, decode_node

P = 0.001
"""Probability of losing a byte, of adding one and of flipping one bit of one."""


def test_a_standard_node():
    node = Node(round(123.5 * 64), round(1500.25 * 4), 47, is_first=True)
    assert node.encode() == bytes.fromhex("BD C1 3D 71 17")
    assert decode_node(bytes.fromhex("BD C1 3D 71 17")) == node
    assert decode_node(bytes.fromhex("02 FF B3 00 00")) == Node(360 * 64 - 1, 0, 0)


@pytest.mark.parametrize(
    "bad", ["BC C1 3D 71 17", "BF C1 3D 71 17", "BD C0 3D 71 17", "BD 01 B4 71 17"]
)
def test_what_is_no_node_is_refused(bad):
    with pytest.raises(ProtocolError):
        decode_node(bytes.fromhex(bad))


def test_an_express_capsule():
    capsule = Capsule(640, (1500,) * EXPRESS_SAMPLES, (58,) * EXPRESS_SAMPLES, is_first=True)
    frame = bytes.fromhex("A2 50 80 82") + 16 * bytes.fromhex("73 17 73 17 AA")
    assert encode_express(capsule) == frame
    assert decode_express(frame) == capsule
    # The next capsule begins 16 deg on, so that a step is half a degree
    angles = sample_angles(capsule, 16 * 64)
    assert angles == pytest.approx([(2.75 + 0.5 * k) % 360 for k in range(EXPRESS_SAMPLES)])


def test_a_dense_capsule():
    capsule = Capsule(640, (1500,) * DENSE_SAMPLES, is_first=True)
    frame = bytes.fromhex("A2 50 80 82") + 40 * bytes.fromhex("DC 05")
    assert encode_dense(capsule) == frame
    assert decode_dense(frame) == capsule
    assert sample_angles(capsule, 28.8 * 64)[-1] == pytest.approx(10 + 39 * 0.72)
    with pytest.raises(ProtocolError, match="damaged"):
        decode_dense(frame[:-1] + b"\x04")
    with pytest.raises(ProtocolError, match="361"):
        decode_dense(encode_dense(Capsule(361 * 64, capsule.distances_mm)))


def random_capsules(count, seed=0):
    rng = np.random.default_rng(seed)
    distances = rng.integers(50, 12000, (count, DENSE_SAMPLES)).tolist()
    return [
        Capsule(round(28.8 * 64 * k) % (360 * 64), tuple(row)) for k, row in enumerate(distances)
    ]


def damage(data, faults, seed):
    """Return ``data`` as it arrives over a line with ``faults``."""
    return Line(None, faults, seed)._add_faults(data)


def feed_in_pieces(splitter, data, size=50):
    frames = []
    for at in range(0, len(data), size):
        frames += splitter.feed(data[at : at + size], at / size)
    return frames


@pytest.mark.parametrize("size", [1, 7, 84, 85, 1000])
def test_every_capsule_of_a_sound_line_is_found_when_it_has_arrived(size):
    data = b"".join(map(encode_dense, random_capsules(50)))
    splitter = CapsuleSplitter()
    frames = feed_in_pieces(splitter, b"\x55\xa0\x50" + data, size)
    assert [frame.data for frame in frames] == [
        data[at : at + CAPSULE_LENGTH]
        for at in range(0, len(data) - CAPSULE_LENGTH, CAPSULE_LENGTH)
    ]
    ends = [(3 + CAPSULE_LENGTH * (k + 1) - 1) // size for k in range(49)]
    assert [frame.arrival for frame in frames] == ends
    assert splitter.bad == 1
    assert [frame.skipped for frame in frames] == [3] + 48 * [0]


@pytest.mark.parametrize("at", [0, 1, 2, 40, 83])
@pytest.mark.parametrize("fault", ["flip", "drop", "insert"])
def test_a_damaged_capsule_is_dropped_alone(at, fault):
    frames = [encode_dense(capsule) for capsule in random_capsules(9)]
    hit = bytearray(frames[4])
    if fault == "flip":
        hit[at] ^= 0x10
    elif fault == "drop":
        del hit[at]
    else:
        hit.insert(at, 0x33)
    splitter = CapsuleSplitter()
    found = feed_in_pieces(splitter, b"".join([*frames[:4], bytes(hit), *frames[5:]]))
    # A byte between two capsules may belong to either: the first might have lost its true end
    lost = 3 if (fault, at) == ("insert", 0) else 4
    assert [f.data for f in found] == [*frames[:lost], *frames[lost + 1 : 8]]
    assert splitter.bad == 1


def test_on_a_bad_line_only_what_is_damaged_is_lost_and_hardly_anything_damaged_passes():
    capsules = random_capsules(4000)
    frames = [encode_dense(capsule) for capsule in capsules]
    pieces = [damage(frame, Faults(P, P, P), k) for k, frame in enumerate(frames)]
    sound = {frame for frame, piece in zip(frames, pieces, strict=True) if frame == piece}
    assert 0.74 < len(sound) / len(frames) < 0.81
    found = {frame.data for frame in feed_in_pieces(CapsuleSplitter(), b"".join(pieces))}
    assert len(sound - found) / len(frames) < 0.001
    # Two flips of the same bit cancel: (84 P)^2 / 2 / 8 of all capsules
    assert len(found - set(frames)) / len(frames) < 0.002


def test_the_checksum_misses_what_theory_says():
    rng = np.random.default_rng(1)
    frame = np.frombuffer(encode_dense(random_capsules(1)[0]), np.uint8)
    # Two flipped bits cancel where they have the same place in their bytes: 1 in 8
    missed = 0
    for _ in range(4000):
        hit = frame.copy()
        at = rng.choice(np.arange(2, CAPSULE_LENGTH), 2, replace=False)
        hit[at] ^= (1 << rng.integers(0, 8, 2)).astype(np.uint8)
        missed += is_taken(hit.tobytes())
    assert missed / 4000 == pytest.approx(1 / 8, abs=0.02)
    # Of random contents 1 in 256 fits
    missed = 0
    for _ in range(12000):
        hit = np.concatenate([frame[:4], rng.integers(0, 256, 80, dtype=np.uint8)])
        missed += is_taken(hit.tobytes())
    assert missed / 12000 == pytest.approx(1 / 256, abs=0.002)


def is_taken(data):
    try:
        decode_dense(data)
    except ProtocolError:
        return False
    return True


def turning_nodes(count, seed=0):
    rng = np.random.default_rng(seed)
    return [
        Node(
            int(1.35 * 64 * k) % (360 * 64),
            int(rng.integers(600, 48000)),
            40,
            is_first=k % 267 == 0,
        )
        for k in range(count)
    ]


@pytest.mark.parametrize("size", [1, 5, 64])
def test_every_node_of_a_sound_line_is_found(size):
    nodes = turning_nodes(600)
    data = b"".join(node.encode() for node in nodes)
    splitter = NodeSplitter()
    found = feed_in_pieces(splitter, data, size)
    assert [decode_node(frame.data) for frame in found] == nodes[: len(found)]
    assert len(found) >= 594
    assert splitter.bad == 0


@pytest.mark.parametrize("at", [0, 1, 3, 4])
@pytest.mark.parametrize("fault", ["flip", "drop", "insert"])
def test_a_node_whose_fixed_bits_are_wrong_is_dropped_alone(at, fault):
    nodes = turning_nodes(60)
    frames = [node.encode() for node in nodes]
    hit = bytearray(frames[30])
    if fault == "flip":
        hit[0 if at else 1] ^= 1
    elif fault == "drop":
        del hit[at]
    else:
        hit.insert(at, 0x30)
    splitter = NodeSplitter()
    found = feed_in_pieces(splitter, b"".join([*frames[:30], bytes(hit), *frames[31:]]), 5)
    found = [frame.data for frame in found]
    # With its first byte a node loses only its quality: which of two it was is not always certain
    kept = [frame for k, frame in enumerate(frames) if k != 30 and (at > 0 or k != 29)]
    found = [frame for frame in found if frame in kept]
    assert len(found) >= len(kept) - 8
    assert found == kept[: len(found)]


def test_of_flipped_bits_in_nodes_37_of_40_go_unnoticed():
    rng = np.random.default_rng(2)
    frame = np.frombuffer(Node(64 * 100, 6000, 40).encode(), np.uint8)
    missed = 0
    for _ in range(2000):
        hit = frame.copy()
        hit[rng.integers(5)] ^= 1 << rng.integers(8)
        try:
            decode_node(hit.tobytes())
            missed += 1
        except ProtocolError:
            pass
    # The highest bit of the angle too: it would lie beyond a turn
    assert missed / 2000 == pytest.approx(36.5 / 40, abs=0.03)
