"""Registration of two sweeps; target first, as everywhere.

``register`` works on the grids the sweeps were taken on: plane surfels (``surfels``), projective
association and whitened residuals (``point_to_plane``), maximum a posteriori steps with a test for
degeneracy (``gauss_newton``), several starts judged by free space (``multistart``). Clouds that
have lost their grid go point to plane (``clouds``). ``icp`` is the paper's plain point-to-point
ICP, kept for the faithful preset.
"""

from __future__ import annotations

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration.clouds import Cloud, prepare_cloud, register_clouds
from scan3d_twin.core.registration.gauss_newton import Criteria, Dof
from scan3d_twin.core.registration.multistart import register_grids
from scan3d_twin.core.registration.pose_prior import PosePrior
from scan3d_twin.core.registration.scan_noise import ScanNoise
from scan3d_twin.core.registration.surfel_grid import SurfelGrid, prepare
from scan3d_twin.core.types import FloatArray, Pose2, RangeImage, RegistrationResult, Scan3D

__all__ = [
    "Cloud",
    "Criteria",
    "PosePrior",
    "ScanNoise",
    "SurfelGrid",
    "prepare",
    "prepare_cloud",
    "register",
]


def register(
    target: RangeImage | SurfelGrid | Scan3D | Cloud | FloatArray,
    source: RangeImage | SurfelGrid | Scan3D | Cloud | FloatArray,
    *,
    prior: PosePrior | None = None,
    init_T_target_source: Pose2 | FloatArray | None = None,
    dof: Dof = "planar",
    criteria: Criteria | None = None,
    starts: int = 1,
) -> RegistrationResult:
    """Lay the scan ``source`` on the scan ``target``.

    Args:
        target: A sweep as a ``RangeImage``, or what ``prepare`` made of it (for several
            registrations); or a cloud: a ``Scan3D``, points (n, 3) [m] seen from their origin, or
            what ``prepare_cloud`` made of them. Sweeps register better, as their grid of lines and
            beams knows the noise of every reading.
        source: Likewise.
        prior: What is known of the pose beforehand; it decides where the scans do not.
        init_T_target_source: First guess, as (4, 4) or in the plane; the prior's mean, or identity
            without one.
        dof: ``planar`` estimates x, y and theta, ``se3`` all six.
        criteria: Widest gate, and when to stop.
        starts: Starts spread over the prior; several find the right one of several basins (sweeps
            only, as clouds do not know where space is free).

    Returns:
        Pose, covariance, what stayed undetermined and how ambiguous the basins are.

    Raises:
        ConfigError: A pose, an option or an array's shape is wrong.
        RegistrationError: A scan shows too little surface, or the two do not overlap.

    >>> y, z = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.3, 0.3, 30))
    >>> wall = np.stack([1.0 + 0.1 * np.sin(9 * y), y, z], axis=-1).reshape(-1, 3)
    >>> result = s3d.register(wall, wall + (0.0, 0.02, 0.0))
    >>> result.converged, np.round(result.T_target_source[:2, 3], 2).tolist()
    (True, [0.0, -0.02])
    """
    target, source = _without_lines(target), _without_lines(source)
    init = init_T_target_source
    init = init.matrix() if isinstance(init, Pose2) else init
    if isinstance(target, RangeImage | SurfelGrid) and isinstance(source, RangeImage | SurfelGrid):
        return register_grids(
            target if isinstance(target, SurfelGrid) else prepare(target),
            source if isinstance(source, SurfelGrid) else prepare(source),
            init_T_target_source=init,
            prior=prior,
            dof=dof,
            criteria=criteria,
            starts=starts,
        )
    if isinstance(target, RangeImage | SurfelGrid) or isinstance(source, RangeImage | SurfelGrid):
        raise ConfigError("cannot register a sweep and a cloud: give two sweeps or two clouds")
    if starts != 1:
        raise ConfigError(f"clouds are registered from one start, got starts = {starts}")
    return register_clouds(
        target, source, init_T_target_source=init, prior=prior, dof=dof, criteria=criteria
    )


def _without_lines(
    scan: RangeImage | SurfelGrid | Scan3D | Cloud | FloatArray,
) -> RangeImage | SurfelGrid | Cloud | FloatArray:
    """Return ``scan``; of a ``Scan3D`` its points (n, 3) [m], as it has no noise per reading."""
    return scan.points if isinstance(scan, Scan3D) else scan
