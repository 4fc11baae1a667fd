"""What runs compiled: loops in place of arrays, and the iteration around them as it stands.

The functions have the arguments and the results of the array functions of the same names.
"""

from __future__ import annotations

from scan3d_twin.core.registration import (
    algebra,
    gauss_newton,
    pose_prior,
    projection,
    scan_noise,
)
from scan3d_twin.core.registration import survey as surveys
from scan3d_twin.core.registration.edge_kernels import edge_rows, edge_sums
from scan3d_twin.core.registration.jit import as_written, jit
from scan3d_twin.core.registration.pair_kernels import lookup, normal_equations, violations
from scan3d_twin.core.registration.surfel_kernels import fit_surfels, line_residuals, sampled

__all__ = (
    "descend", "edge_rows", "edge_sums", "fit_surfels", "line_residuals", "lookup",
    "nearest", "normal_equations", "sampled", "survey", "violations",
)  # fmt: skip

for function in (
    algebra.block, algebra.determined, algebra.inverse, algebra.picked, algebra.projected,
    algebra.quadratic, algebra.without_scale, gauss_newton.apart, gauss_newton.knowledge,
    gauss_newton.length, gauss_newton.new_basin, gauss_newton.prior_information, gauss_newton.reach,
    gauss_newton.solve, gauss_newton.tightened, pose_prior.about_target, pose_prior.deviation,
    pose_prior.displaced, pose_prior.displacement, pose_prior.exp_so3, pose_prior.log_so3,
    scan_noise.estimate_range_noise, scan_noise.quarters, scan_noise.yaw_jitter, surveys.extent,
    surveys.half_sizes,
):  # fmt: skip
    as_written(function)

descend = jit(gauss_newton.descend)
nearest = jit(projection.nearest)
survey = jit(surveys.survey)
