"""A sweep as a lidar saw it that does not sit where it should, or whose heading errs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.types import FloatArray, Observation, RangeImage, read_only


def mounted(T_base_lidar: FloatArray, mount: MountConfig) -> FloatArray:
    """Return ``T_base_lidar`` (4, 4) shifted to the left and then leaning and looking down."""
    T = T_base_lidar.copy()
    T[1, 3] += mount.lateral
    T[:3, :3] = T[:3, :3] @ tilt(mount.roll, mount.pitch)
    return T


def tilt(roll: float, pitch: float) -> FloatArray:
    """Return Ry(pitch) Rx(roll) (3, 3)."""
    (cr, cp), (sr, sp) = np.cos([roll, pitch]), np.sin([roll, pitch])
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def corrected(observation: Observation, mount: MountConfig) -> Observation:
    """Return a sweep with the mount as calibrated; as it is where all of it is 0."""
    if mount == MountConfig():
        return observation
    image = observation.image
    yaws = (1.0 + mount.yaw_scale) * image.yaws + mount.time_offset * turn_rate(image)
    T = mounted(image.T_base_lidar, mount)
    image = replace(image, yaws=read_only(yaws), T_base_lidar=read_only(T))
    return replace(observation, image=image)


def turn_rate(image: RangeImage) -> float:
    """Return how fast the base turned while it swept, left positive [rad/s]."""
    middle = image.yaws[:, image.spec.n_beams // 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.diff(middle) / np.diff(image.stamps)
    rates = rates[np.isfinite(rates)]
    return float(np.median(rates)) if len(rates) else 0.0


def composed(first: MountConfig, then: MountConfig) -> MountConfig:
    """Return the mount that corrects by ``first`` and then by ``then``, for small angles."""
    return MountConfig(
        lateral=first.lateral + then.lateral,
        roll=first.roll + then.roll,
        pitch=first.pitch + then.pitch,
        yaw_scale=(1.0 + first.yaw_scale) * (1.0 + then.yaw_scale) - 1.0,
        time_offset=first.time_offset + then.time_offset,
    )


def in_words(mount: MountConfig) -> str:
    """Return ``mount`` for people."""
    return (
        f"{1e3 * mount.lateral:+.1f} mm to the left, leaning {math.degrees(mount.roll):+.2f} deg, "
        f"looking down {math.degrees(mount.pitch):+.2f} deg, turning {mount.yaw_scale:+.2%}"
    )
