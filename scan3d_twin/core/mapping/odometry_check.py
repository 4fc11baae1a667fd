"""Whether scan matching contradicts the odometry view after view: a wrong model of the base.

The motion model learns by how much a robot turns more than its odometry says, from the turn of the
first panorama and from each registration. Its prior expects what is configured (``planning.gamma``)
and would take a much larger error for a wrong registration, so that here the prior is wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from scan3d_twin.core.mapping.motion_model import TURNS, MotionModel
from scan3d_twin.core.session import Session

SIGMAS = 3.0
"""Standard deviations beyond which the odometry is wrong: 0.3 % of good robots by chance."""
MIN_PROOFS = 2
"""Fewest measurements that prove it: registered moves, and the turn of the first panorama."""
WIDE_GAMMA, VARIATION = 0.1, 0.1
"""Prior of the relative error of turns [rad/rad]: that of a Create 2 taken for a Create 1; and the
share of it that changes from move to move. Assumptions."""


@dataclass(frozen=True, slots=True)
class TurnError:
    """The relative error of a robot's turns.

    Attributes:
        scale: What it turns more than its odometry says, as a share of that.
        sigma: Standard deviation of ``scale``.
        proofs: Number of measurements: registered moves, and the first panorama's turn.
        gamma: Configured standard deviation of ``scale``.
    """

    scale: float
    sigma: float
    proofs: int
    gamma: float

    @property
    def is_significant(self) -> bool:
        """Whether several measurements show an error beyond the one that is configured."""
        allowed = SIGMAS * math.hypot(self.gamma, self.sigma)
        return self.proofs >= MIN_PROOFS and abs(self.scale) > allowed

    def __str__(self) -> str:
        more = "more" if self.scale > 0 else "less"
        return (
            f"The base turns {abs(self.scale):.1%} {more} than it says, by {self.proofs} "
            f"measurements ({self.gamma:.1%} is normal): wrong model (--robot), other wheels, or a "
            "slippery floor?"
        )


def measure_turn_error(session: Session) -> TurnError:
    """Return the error of the turns between the views of ``session``."""
    config, planning = session.config, session.config.planning
    wide = replace(planning, gamma=WIDE_GAMMA, motion_variation=VARIATION)
    model = MotionModel.of(session.views, replace(config, planning=wide))
    results = (v.registration for v in session.views if v.observation.has_odometry)
    proofs = sum(result is not None and result.converged for result in results)
    proofs += config.mount.yaw_scale != 0.0
    sigma = math.sqrt(float(model.covariance[TURNS, TURNS]))
    return TurnError(float(model.mean[TURNS]), sigma, proofs, planning.gamma)
