"""The angle of a turning axis and the mount of the lidar on it, from the transforms of a recording.

Of the chain of frames from the lidar to the root, the transform that turns most is the axis. What
lies between it and the lidar is the mount; what lies beyond it is left out, as registration finds
where the scanner stood.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import FloatArray
from scan3d_twin.recording.checks import MAX_LENGTH

MIN_TURN = math.radians(5.0)
"""Least angle by which an axis turns in a recording [rad]."""
MAX_OFF_CENTRE = 0.01
"""Largest distance from its circle at which a frame goes round a fixed axis [m]: a robot that turns
on the spot, and the noise of its transforms."""
MAX_FITTED = 2000
"""Number of samples by which that circle is fitted."""
MAX_NORM_ERROR = 0.1
"""Largest difference of the norm of a quaternion from 1; others are no rotation."""
MAX_FRAMES = 100
"""Longest chain of frames."""


@dataclass
class FrameTree:
    """Transforms by the frame that they place: stamps, translations and rotations in its parent.

    Attributes:
        parents: Parent of each frame.
        samples: Time [s], x, y, z [m] and quaternion x, y, z, w of each frame in its parent.
    """

    parents: dict[str, str] = field(default_factory=dict)
    samples: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)

    def add(self, message: Any) -> None:
        """Add the transforms of a ``tf2_msgs/TFMessage``."""
        for each in message.transforms:
            child, parent = each.child_frame_id.lstrip("/"), each.header.frame_id.lstrip("/")
            place, turn = each.transform.translation, each.transform.rotation
            row = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            far = max(abs(value) for value in row[:3])
            if far <= MAX_LENGTH and abs(math.hypot(*row[3:]) - 1.0) < MAX_NORM_ERROR:
                self.parents[child] = parent
                stamp = each.header.stamp.sec + each.header.stamp.nanosec / 1e9
                self.samples.setdefault(child, []).append((stamp, *row))

    def chain(self, frame: str) -> list[str]:
        """Return ``frame`` and the frames above it that have parents, the nearest first."""
        frames: list[str] = []
        while frame in self.parents and frame not in frames and len(frames) < MAX_FRAMES:
            frames.append(frame)
            frame = self.parents[frame]
        return frames


@dataclass(frozen=True)
class TurningAxis:
    """An axis that turns, and what it carries.

    Attributes:
        name: Its frame, or joint.
        stamps: Times of the angles (n,), ascending [s].
        angles: Angle about the axis, not wrapped (n,) [rad].
        T_axis_laser: Mount of the lidar's frame, its scan plane x-y, on the axis, its z (4, 4);
            None if unknown.
        R_root_axis: Rotation (3, 3) of the axis at its angle 0 in the root, whose z is up; None if
            unknown.
        places: Where the axis stood (n, 3) [m]; None if unknown.
    """

    name: str
    stamps: FloatArray
    angles: FloatArray
    T_axis_laser: FloatArray | None = None
    R_root_axis: FloatArray | None = None
    places: FloatArray | None = None

    def at(self, times: FloatArray) -> FloatArray:
        """Return the angle at ``times`` (...) [rad]; NaN before the first and after the last."""
        found = np.interp(times, self.stamps, self.angles, left=np.nan, right=np.nan)
        return np.asarray(found)

    def place_at(self, times: FloatArray) -> FloatArray | None:
        """Return where the axis stood at ``times`` (n,) in (n, 3) [m]; None if unknown."""
        if self.places is None:
            return None
        columns = [np.interp(times, self.stamps, self.places[:, k]) for k in range(3)]
        return np.stack(columns, axis=1)


def find_turning_axis(tree: FrameTree, frame: str) -> TurningAxis | None:
    """Return what turns the lidar whose scans are in ``frame``; None if nothing does.

    With R_0 the first rotation of the turning frame in its parent, u its axis and B a rotation that
    takes z to u, its rotation by theta is R_0 B Rz(theta) B^T: the frame ``axis`` is that of B.
    """
    chain = tree.chain(frame.lstrip("/"))
    turns = [_measure_turn(tree.samples[each]) for each in chain]
    if not turns or max(turns) < MIN_TURN:
        return None
    k = int(np.argmax(turns))

    # Find the axis, and the angle about it
    rows = _sort(tree.samples[chain[k]])
    turning = Rotation.from_quat(rows[:, 4:8])
    turned = (turning[0].inv() * turning).as_rotvec()
    widest = turned[int(np.argmax(np.linalg.norm(turned, axis=1)))]
    u = widest / np.linalg.norm(widest)
    u = -u if u[int(np.argmax(np.abs(u)))] < 0 else u
    B = Rotation.align_vectors([u], [[0.0, 0.0, 1.0]])[0]

    # Compose what is above and below it
    above, mount = np.eye(4), np.eye(4)
    for each in reversed(chain[k + 1 :]):
        above = above @ _matrix(tree.samples[each][0])
    for each in reversed(chain[:k]):
        mount = mount @ _matrix(tree.samples[each][0])
    offset, places = _find_centre(turning.as_matrix(), rows[:, 1:4])
    R_root_axis = above[:3, :3] @ (turning[0] * B).as_matrix()
    mount[:3, 3] += offset - (offset @ u) * u  # along the axis, any origin is on it
    mount[:3] = B.as_matrix().T @ mount[:3]
    return TurningAxis(chain[k], rows[:, 0], np.unwrap(turned @ u), mount, R_root_axis, places)


def _find_centre(R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where a frame is from the axis about which it turns (3,), and the axis (n, 3) [m].

    A frame that is not on the axis goes round it: t = p + R q, with p on the axis and the frame at
    q from it, both fixed. Where no p and q fit, as on a robot that drives, the axis is the frame.

    Args:
        R: Rotations of the frame in its parent (n, 3, 3).
        t: Its positions (n, 3) [m].
    """
    few = slice(None, None, max(1, len(t) // MAX_FITTED))
    A = np.concatenate([np.broadcast_to(np.eye(3), R[few].shape), R[few]], axis=2).reshape(-1, 6)
    found = np.linalg.lstsq(A, t[few].ravel(), rcond=1e-6)[0]
    p, q = found[:3], found[3:]
    off = np.linalg.norm(t - p - R @ q, axis=1)
    if float(np.max(off)) > MAX_OFF_CENTRE:
        return np.zeros(3), t
    return q, np.broadcast_to(p, t.shape)


def find_joint(
    joints: dict[str, list[tuple[float, float]]], name: str | None, origin: str
) -> TurningAxis | None:
    """Return the joint ``name``, or the one that turns most; None if none does.

    Raises:
        FileError: There is no such joint.
    """
    if name is not None and name not in joints:
        known = ", ".join(sorted(joints)) or "none"
        raise FileError(f"{origin}: no joint {name!r}; joints: {known}")
    chosen = [name] if name is not None else sorted(joints, key=lambda each: -_span(joints[each]))
    for each in chosen[:1]:
        if _span(joints[each]) >= MIN_TURN:
            rows = np.array(sorted(set(joints[each])))
            return TurningAxis(each, rows[:, 0], np.unwrap(rows[:, 1]))
    return None


def _span(rows: Sequence[tuple[float, float]]) -> float:
    return float(np.ptp([position for _, position in rows])) if rows else 0.0


def _sort(samples: list[tuple[float, ...]]) -> FloatArray:
    """Return samples (n, 8) by time, each time once."""
    rows = np.array(samples)
    return rows[np.unique(rows[:, 0], return_index=True)[1]]


def _measure_turn(samples: list[tuple[float, ...]]) -> float:
    """Return by how much the samples turn away from the first one at most [rad]."""
    turns = Rotation.from_quat(np.array(samples)[:, 4:8])
    return float(np.max((turns[0].inv() * turns).magnitude()))


def _matrix(sample: tuple[float, ...]) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(sample[4:8]).as_matrix()
    T[:3, 3] = sample[1:4]
    return T
