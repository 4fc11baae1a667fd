"""Extrinsics: corrections of sweeps for a lidar that is mounted or timed other than designed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.types import FloatArray, Observation, RangeImage, read_only


def apply_mount(T_base_lidar: FloatArray, mount: MountConfig) -> FloatArray:
    """Return the extrinsics ``T_base_lidar`` (4, 4), corrected by offset and turns of ``mount``."""
    T = T_base_lidar.copy()
    T[1, 3] += mount.lateral
    if mount.yaw != 0.0:
        T[:3, :3] = T[:3, :3] @ yaw_matrix(mount.yaw)
    T[:3, :3] = T[:3, :3] @ tilt_matrix(mount.roll, mount.pitch)
    return T


def yaw_matrix(yaw: float) -> FloatArray:
    """Return the rotation matrix Rz(yaw) (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def tilt_matrix(roll: float, pitch: float) -> FloatArray:
    """Return the rotation matrix Ry(pitch) Rx(roll) (3, 3)."""
    (cr, cp), (sr, sp) = np.cos([roll, pitch]), np.sin([roll, pitch])
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def correct_extrinsics(observation: Observation, mount: MountConfig) -> Observation:
    """Return a sweep corrected by the calibrated ``mount``; as it is if all of it is 0.

    The yaw scale is that of the wheels: a turntable measures its angle. Play and lean of the axis
    are those of a turntable.
    """
    if mount == MountConfig():
        return observation
    image = observation.image
    axis, rate = image.T_scan_axis, measure_turn_rate(image)
    scale = mount.yaw_scale if axis is None else 0.0
    yaws = (1.0 + scale) * image.yaws + mount.time_offset * rate
    T = apply_mount(image.T_base_lidar, mount)
    if axis is not None:
        yaws = yaws + find_play_lag(mount.play, rate)
        axis = read_only(lean_axis(axis, float(T[2, 3]), mount))
    image = replace(image, yaws=read_only(yaws), T_base_lidar=read_only(T), T_scan_axis=axis)
    return replace(observation, image=image)


def find_play_lag(play: float, rate: float) -> float:
    """Return the angle [rad] by which a turntable of that ``play`` is ahead of its sensor."""
    return -math.copysign(play / 2, rate) if rate else 0.0


def lean_axis(T_scan_axis: FloatArray, along: float, mount: MountConfig) -> FloatArray:
    """Return ``T_scan_axis`` (4, 4) with the lean of ``mount``, about the lidar's place on it.

    Args:
        T_scan_axis: Pose of the axis as designed (4, 4).
        along: Place of the lidar along the axis [m].
        mount: What was calibrated.
    """
    if mount.axis_roll == mount.axis_pitch == 0.0:
        return T_scan_axis
    T, R = T_scan_axis.copy(), tilt_matrix(mount.axis_roll, mount.axis_pitch)
    middle = T[:3, 3] + along * T[:3, 2]
    T[:3, :3] = R @ T[:3, :3]
    T[:3, 3] = middle + R @ (T_scan_axis[:3, 3] - middle)
    return np.asarray(T)


def measure_turn_rate(image: RangeImage) -> float:
    """Return the turn rate of the base during a sweep, left positive [rad/s]."""
    middle = image.yaws[:, image.spec.n_beams // 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.diff(middle) / np.diff(image.stamps)
    rates = rates[np.isfinite(rates)]
    return float(np.median(rates)) if len(rates) else 0.0


def compose_mounts(first: MountConfig, then: MountConfig) -> MountConfig:
    """Return the correction by ``first`` and then by ``then`` as one, for small angles."""
    return MountConfig(
        lateral=first.lateral + then.lateral,
        roll=first.roll + then.roll,
        pitch=first.pitch + then.pitch,
        yaw_scale=(1.0 + first.yaw_scale) * (1.0 + then.yaw_scale) - 1.0,
        time_offset=first.time_offset + then.time_offset,
        yaw=first.yaw + then.yaw,
        play=first.play + then.play,
        axis_roll=first.axis_roll + then.axis_roll,
        axis_pitch=first.axis_pitch + then.axis_pitch,
    )


def describe_mount(mount: MountConfig) -> str:
    """Return ``mount`` in words."""
    return (
        f"{1e3 * mount.lateral:+.1f} mm to the left, leaning {math.degrees(mount.roll):+.2f} deg, "
        f"looking down {math.degrees(mount.pitch):+.2f} deg, turning {mount.yaw_scale:+.2%}"
    )
