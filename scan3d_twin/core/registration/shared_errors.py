"""Errors that many readings share, as unknowns of the last Gauss-Newton step.

The iteration weights each pair of surfels as if its readings erred independently, but for a factor
(see ``point_to_plane``). The range error of a lidar is not like that: a URG-04LX is off by a few
millimetres that depend on the distance in cycles, on the surface and on the temperature (Kneip et
al., ICRA 2009; Okubo et al., SPIE 7332, 2009). Once the iteration has converged, one more step adds
unknowns for such errors and marginalises them, which is generalised least squares with the
covariance that they give the residuals. With the notation of ``point_to_plane``, b_s and b_t the
cosines between the mean normal and the rays of source and target, and r_s, r_t their lengths, the
residual of a pair is

    e + J x + b_s (m + u a + v h + f(r_s)) - b_t f(r_t) + c y = noise of variance c_r s^2,

with these unknowns besides the pose and the yaw scale x:

* **Patches** m, u, v: the mean and the slopes along azimuth and height of an error that the
  readings of a patch share, one patch for each 15 deg of azimuth and twelfth of the sphere's height
  about the source's lidar; a, h = -1..1 are a ray's place in it. Each of the three has the standard
  deviation ``patch``. They stand for material, incidence and edges.
* **Curve** f: an error that depends on the range only and is the same in both sweeps, linear
  between knots 0.25 m apart, constant beyond 5.75 m, with the prior covariance of a Gaussian
  process (rational quadratic kernel; Rasmussen and Williams 2006, 4.19) of length l = 0.25 m

      k(d) = linearity^2 / (1 + d^2 / 2 l^2) + offset^2 + (0.1 mm)^2 [d = 0].

* **Lines** y: the yaw error of each source line, of unit variance in units of c.
* **Floor**: z, roll and pitch, if they are not estimated, with the standard deviations ``height``
  and ``lean``.

Noise moves a reading along its ray, and thereby the residual, its derivatives and the choice of its
partner together. A curve or a yaw scale that the surface hardly determines would take that up. All
derivatives are therefore those at the point of the source's ray on which both readings agree best,

    a - v_s / (v_s + v_t) e / b_s d_s,

with d_s the unit vector along the ray, v_s and v_t the variances of the readings along the normal:
its noise is independent of that of e. The target's ray and yaw are those that lead to this point.

``correlation`` c_r is the factor on the variance of a mean of neighbouring readings, whose noise is
correlated. The factor for a range bias is not applied in this step.

Of the normal equations of all unknowns, those of lines and patches are eliminated by their Schur
complements, then those directions of the pose that are degenerate, as if the data could shift along
them freely (so that no unknown takes up the prior's error there), and last curve, floor and yaw
scale. What is left is the equation of ``gauss_newton``.

**Spread.** Assumptions may be wrong. By substitution the step gives the patches' means p_k in
assumed standard deviations; their mean square is 1 less their remaining variance v_k. The spread of
the patches is the root of

    (4 + sum p_k^2) / (4 + sum (1 - v_k)),

in which the assumption counts like four errors, and that of curve, floor and yaw scale is the same
of their values y with the prior information P: y^T P y, and the share of each that the scans
determine. The step is then solved once more. The patches' standard deviation is multiplied by their
spread, as a sweep has many of them: by 0.60 in usual ones (median of 105 pairs of random scenes in
the world ``typical``); above 1 by its square, as the four assumed errors hide half of what is in
excess. The other errors are few, and their assumption holds for worse floors, too: their spread is
0.77 in the same pairs and 1.08 in the world ``harsh``, whose errors are twice as large. Where it
exceeds 1.4 usual ones, their standard deviations are multiplied by its squared ratio to the usual
one; they are never made smaller.

``native/shared_errors.h`` and ``native/descend.h`` compute this.
"""

from __future__ import annotations

from scan3d_twin.core.registration.pose_prior import SIGMA_TILT, SIGMA_Z
from scan3d_twin.core.registration.surfels.grid import SurfelGrid


def combine_shared_errors(target: SurfelGrid, source: SurfelGrid) -> dict[str, float]:
    """Return what is assumed of the errors that readings of two sweeps share.

    ``patch``, ``linearity``, ``offset`` [m], ``height`` [m] and ``lean`` [rad] are standard
    deviations, ``correlation`` is a factor on variances, and ``ahead`` and ``up`` are the position
    of the source's lidar in ``base`` [m].
    """
    noises = (target.noise, source.noise)
    return {
        "patch": max(noise.bias_sigma for noise in noises),
        "linearity": max(noise.linearity_sigma for noise in noises),
        "offset": max(noise.offset_sigma for noise in noises),
        "correlation": sum(noise.correlation for noise in noises) / 2,
        "height": SIGMA_Z,
        "lean": SIGMA_TILT,
        "ahead": float(source.image.T_base_lidar[0, 3]),
        "up": float(source.image.T_base_lidar[2, 3]),
    }
