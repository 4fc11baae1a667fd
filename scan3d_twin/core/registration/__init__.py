"""Registration of two scans, with a covariance: ICP on sweeps and on point clouds.

Functions take ``target`` first. ``register`` works on the grid of lines and beams of the sweeps:
plane surfels (``surfels``), projective data association and point-to-plane residuals
(``point_to_plane``), Gauss-Newton with a prior and a test for degeneracy (``gauss_newton``), and
multistart judged by free space (``multistart``). Unorganised clouds are registered by surface
patches at several resolutions (``clouds``). ``icp`` is the paper's point-to-point ICP, eq. (1), for
the preset ``paper``.
"""

from __future__ import annotations

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration.clouds.patches import Cloud, prepare_cloud
from scan3d_twin.core.registration.clouds.registration import register_clouds
from scan3d_twin.core.registration.gauss_newton import Criteria, Dof
from scan3d_twin.core.registration.multistart import register_grids
from scan3d_twin.core.registration.pose_prior import PosePrior
from scan3d_twin.core.registration.surfels.grid import SurfelGrid, extract_pair, extract_surfels
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise
from scan3d_twin.core.types import FloatArray, Pose2, RangeImage, RegistrationResult, Scan3D

__all__ = [
    "Cloud",
    "Criteria",
    "PosePrior",
    "ScanNoise",
    "SurfelGrid",
    "extract_surfels",
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
    """Register the scan ``source`` to the scan ``target``.

    Args:
        target: A sweep: a ``RangeImage``, or for several registrations the result of
            ``extract_surfels``, each with its own noise. Or a cloud: a ``Scan3D``, points (n, 3)
            [m] seen from their origin, or the result of ``prepare_cloud``. Sweeps register better,
            since their grid of lines and beams gives the noise of every reading.
        source: A scan of the same kind as ``target``.
        prior: Prior distribution of the pose; it decides in directions the scans leave free.
        init_T_target_source: Initial guess, (4, 4) or planar; by default the prior's mean, else
            identity.
        dof: ``planar`` estimates x, y and theta, ``se3`` all six.
        criteria: Convergence criteria and the first gate.
        starts: Number of starts, spread over the prior, to find the best of several basins. Clouds
            need no prior for it, and take more starts than one by themselves where a part of the
            source finds no place on the target.

    Returns:
        Pose, covariance, degenerate directions and the ambiguity gap between basins. Where scans
        without a prior leave a direction undetermined, its variance and ``predicted_rmse`` are
        infinite. Where they determine none, or contradict each other (one shows surface where the
        other saw through), ``converged`` is False.

    Raises:
        ConfigError: A pose, an option or an array's shape is wrong.
        RegistrationError: A scan shows too little surface, or the two do not overlap.

    >>> y, z = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.3, 0.3, 30))
    >>> wall = np.stack([1.0 + 0.1 * np.sin(9 * y), y, z], axis=-1).reshape(-1, 3)
    >>> result = s3d.register(wall, wall + (0.0, 0.02, 0.0))
    >>> result.converged, round(float(result.T_target_source[1, 3]), 2)
    (True, -0.02)
    """
    # Accept every kind of scan.
    target, source = _without_lines(target), _without_lines(source)
    init = init_T_target_source
    init = init.matrix() if isinstance(init, Pose2) else init

    # Two sweeps.
    if isinstance(target, RangeImage) and isinstance(source, RangeImage):
        target, source = extract_pair(target, source)
    if isinstance(target, RangeImage | SurfelGrid) and isinstance(source, RangeImage | SurfelGrid):
        return register_grids(
            target if isinstance(target, SurfelGrid) else extract_surfels(target),
            source if isinstance(source, SurfelGrid) else extract_surfels(source),
            init_T_target_source=init,
            prior=prior,
            dof=dof,
            criteria=criteria,
            starts=starts,
        )

    # Two clouds.
    if isinstance(target, RangeImage | SurfelGrid) or isinstance(source, RangeImage | SurfelGrid):
        raise ConfigError("cannot register a sweep and a cloud: give two sweeps or two clouds")
    return register_clouds(
        target,
        source,
        init_T_target_source=init,
        prior=prior,
        dof=dof,
        criteria=criteria,
        starts=starts,
    )


def _without_lines(
    scan: RangeImage | SurfelGrid | Scan3D | Cloud | FloatArray,
) -> RangeImage | SurfelGrid | Cloud | FloatArray:
    """Return ``scan``, or the points (n, 3) [m] of a ``Scan3D``, which has no noise per reading."""
    return scan.points if isinstance(scan, Scan3D) else scan
