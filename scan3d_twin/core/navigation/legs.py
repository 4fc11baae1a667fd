"""A move as legs: each is a turn on the spot, then a straight drive.

Odometry errs in proportion to what the wheels did, not to where the robot ended up: a robot that
turned by 270 deg to the left instead of by 90 deg to the right stands as before, with three times
the error. The turns of legs are therefore not wrapped.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from scan3d_twin.core.types import FloatArray, Pose2, wrap

Legs = tuple[tuple[float, float], ...]
"""Turn [rad] and length of the drive that follows it [m] of each leg; the last may be a turn."""
SAME_DRIVE_ANGLE = math.radians(2.0)
"""Change of heading up to which a drive goes on [rad]: steering back to the line changes less."""
MIN_DRIVE = 0.005
"""Length of a drive that is one [m]: in a turn on the spot the axis moves by less."""
MAX_GAP, MAX_GAP_ANGLE = 0.05, math.radians(5.0)
"""Difference between a move and its legs up to which they are believed [m], [rad]."""


def measure_legs(before: Pose2, poses: Iterable[Pose2], yaw: float) -> Legs:
    """Return the legs of a move, by odometry.

    Args:
        before: Pose of the sweep that the move began at; its heading is less than half a turn from
            the first of ``poses``.
        poses: ``T_odom_base`` on the way, close together, up to the end of the next sweep.
        yaw: Heading of that sweep's middle [rad], less than half a turn from the last of ``poses``.
    """
    legs: list[tuple[float, float]] = []
    turn, heading = 0.0, before.yaw
    for a, b in pairwise([Pose2(before.x, before.y, before.yaw), *poses]):
        turn, heading = turn + wrap(b.yaw - heading), b.yaw
        way = (b.x - a.x) * math.cos(b.yaw) + (b.y - a.y) * math.sin(b.yaw)
        if legs and abs(turn) <= SAME_DRIVE_ANGLE:
            legs[-1] = (legs[-1][0], legs[-1][1] + way)
        elif way:
            legs.append((turn, way))
            turn = 0.0
    return _join_turns([*legs, (turn + wrap(yaw - heading), 0.0)])


def assume_legs(move: Pose2, heading: float = 0.0) -> Legs:
    """Return the legs of a ``move`` by turn, drive and turn, each the shorter way.

    Args:
        move: The move, from the middle of one sweep to that of the next.
        heading: Heading in which the first sweep has left the robot, from its middle [rad].
    """
    length = math.hypot(move.x, move.y)
    if length <= MIN_DRIVE:
        return ((heading + wrap(move.yaw - heading), 0.0),)
    bearing = math.atan2(move.y, move.x)
    return ((heading + wrap(bearing - heading), length), (wrap(move.yaw - bearing), 0.0))


def follow_legs(legs: Legs, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where ``legs`` lead a robot that errs, and how that depends on its errors.

    Args:
        legs: By odometry.
        errors: Relative error of distances, drift of the heading [rad/m] and relative error of
            turns (3,), as of ``mapping.motion_model``.

    Returns:
        x, y [m] and yaw [rad], which is not wrapped, of the end (3,), and its derivative by the
        errors (3, 3), but for the shortening of the arcs' chords.
    """
    c, drift, k = errors.tolist()
    end, A = np.zeros(3), np.zeros((3, 3))
    turned, driven = 0.0, 0.0
    for turn, length in legs:
        turned += turn
        bearing = (1.0 + k) * turned + drift * (driven + length / 2)
        u = np.array([math.cos(bearing), math.sin(bearing)])
        chord = length * float(np.sinc(drift * length / math.tau))
        across = (1.0 + c) * chord * np.array([-u[1], u[0]])
        end[:2] += (1.0 + c) * chord * u
        A[:2] += np.stack([chord * u, (driven + length / 2) * across, turned * across], axis=1)
        driven += length
    A[2, 1], A[2, 2] = driven, turned
    end[2] = (1.0 + k) * turned + drift * driven
    return end, A


def check_legs(legs: Legs, move: Pose2) -> bool:
    """Return whether ``legs`` lead to where ``move`` does."""
    here = Pose2()
    for turn, length in legs:
        here = here @ Pose2(0.0, 0.0, turn) @ Pose2(length, 0.0, 0.0)
    close = here.distance(move) <= MAX_GAP
    return bool(legs) and close and abs(wrap(here.yaw - move.yaw)) <= MAX_GAP_ANGLE


def _join_turns(legs: Iterable[tuple[float, float]]) -> Legs:
    """Return ``legs`` with drives of less than ``MIN_DRIVE`` counted as part of the next turn."""
    joined: list[tuple[float, float]] = []
    pending = 0.0
    for turn, length in legs:
        pending += turn
        if abs(length) >= MIN_DRIVE:
            joined.append((pending, length))
            pending = 0.0
    return (*joined, (pending, 0.0))
