"""Whether a run shows, without the truth, that its sensor or robot errs more than assumed.

The predicted errors hold for a sensor, a robot and a floor as they are assumed. Three ratios of
what a run has found to what is usual say otherwise, and each has a known distribution:

* **readings**: their noise where surfaces are seen frontally, median over the views, by
  ``registration.reading_sigma``; log-normal about 1 with the standard deviation ``READING_SPREAD``;
* **shared**: the root mean square of ``RegistrationResult.shared_spread`` over n registrations;
  log-normal about ``SHARED_MEAN`` with the variance ``SHARED_RUN``^2 + ``SHARED_PAIR``^2 / n, as
  the registrations of one run have a sensor and a robot in common;
* **odometry**: the root of chi2 / k, with chi2 the sum of k squared normalised innovations
  (``MotionModel.of``); chi-square, by the cube root of Wilson and Hilferty (PNAS 17, 1931).

Each is significant beyond a quantile of a third of ``FALSE_ALARMS`` (Bonferroni), whatever the
correlation between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.mapping.scan_matching import select_scope, surfels_of
from scan3d_twin.core.registration.surfels.reading_noise import measure_reading_noise
from scan3d_twin.core.session import Session, View

FALSE_ALARMS = 0.01
"""Share of runs as assumed that are called worse by chance, at most."""
READING_SPREAD = 0.2
"""Standard deviation of the logarithm of the noise of good sensors of one kind (assumption); the
95 % interval of a log, 2.3 to 3.4 mm, is that of 0.1."""
SHARED_MEAN, SHARED_RUN, SHARED_PAIR = 0.07, 0.095, 0.08
"""Mean of the logarithm of ``shared``, and its standard deviations between runs and between the
registrations of a run: random:20400 to 20449 in the world ``typical``, 50 runs, 190 pairs. The
largest of them, 1.33 and 1.30, lie where this distribution has the largest of 50."""
LIMIT = NormalDist().inv_cdf(1.0 - FALSE_ALARMS / 3.0)
"""Normal quantile beyond which a ratio is significant: 2.71."""


@dataclass(frozen=True, slots=True)
class ErrorCheck:
    """Ratios of the errors that a run shows to the usual ones; NaN where it does not tell.

    Attributes:
        readings: Noise of single readings.
        shared: Errors that all readings share.
        odometry: Errors of the odometry.
        pairs: Number of registrations that ``shared`` was found in.
        freedom: Degrees of freedom of ``odometry``.
    """

    readings: float = math.nan
    shared: float = math.nan
    odometry: float = math.nan
    pairs: int = 0
    freedom: int = 0

    @property
    def findings(self) -> dict[str, float]:
        """The ratios that are significantly large, by what they are about, as words."""
        scores = {
            "readings scatter {:.1f} times as widely as those of a good sensor of this kind": (
                self.readings,
                _log_score(self.readings, 0.0, READING_SPREAD),
            ),
            "errors that all readings share are {:.1f} times the usual ones": (
                self.shared,
                _log_score(
                    self.shared,
                    SHARED_MEAN,
                    math.hypot(SHARED_RUN, SHARED_PAIR / math.sqrt(max(1, self.pairs))),
                ),
            ),
            "the odometry errs {:.1f} times as much as configured": (
                self.odometry,
                _chi_score(self.odometry, self.freedom),
            ),
        }
        return {words: ratio for words, (ratio, score) in scores.items() if score > LIMIT}

    @property
    def excess(self) -> float:
        """Factor by which errors may exceed those predicted; 1 where nothing is significant."""
        return max((1.0, *self.findings.values()))

    def __str__(self) -> str:
        found = [words.format(ratio) for words, ratio in self.findings.items()]
        return (
            f"The sensor or the robot is worse than assumed: {', '.join(found)}. Errors may be "
            f"{self.excess:.1f} times the predicted ones. A cold sensor, a dirty window, sunlight, "
            "lost data, an uneven or slippery floor?"
        )


def check_errors(session: Session) -> ErrorCheck:
    """Return how the errors that ``session`` shows compare with the usual ones.

    It is known only of views with an odometry that are registered by surfels.
    """
    config = session.config
    if config.registration.engine != "grid":
        return ErrorCheck()

    # Noise of readings
    noise = [_measure_noise(session, view) for view in session.views]
    known = [sigma for sigma in noise if math.isfinite(sigma)]
    sigma = config.registration.reading_sigma
    readings = float(np.median(known)) / sigma if known and sigma > 0.0 else math.nan

    # Errors that registrations found
    results = [view.registration for view in session.views if view.observation.has_odometry]
    spreads = [r.shared_spread for r in results if r is not None and r.converged]
    spreads = [spread for spread in spreads if math.isfinite(spread)]
    shared = math.sqrt(float(np.mean(np.square(spreads)))) if spreads else math.nan
    motion = MotionModel.of(session.views, config, session.workspace)
    odometry = math.sqrt(motion.chi2 / motion.freedom) if motion.freedom else math.nan
    return ErrorCheck(readings, shared, odometry, len(spreads), motion.freedom)


def _measure_noise(session: Session, view: View) -> float:
    """Return the noise of the readings of a ``view`` seen frontally [m], measured once a scope."""
    if session.config.registration.reading_sigma == 0.0:
        return math.nan
    results = session.workspace.results_of(view.observation.image)
    key = measure_reading_noise, len(select_scope(view, session.config.registration.scope))
    if key not in results:
        try:
            noise = measure_reading_noise(surfels_of(view, session.config, session.workspace))
        except RegistrationError:
            noise = math.nan
        results[key] = noise
    return float(results[key])


def _log_score(ratio: float, mean: float, sigma: float) -> float:
    """Return the normal score of a log-normal ``ratio``; NaN of NaN."""
    return (math.log(ratio) - mean) / sigma if ratio > 0.0 else math.nan


def _chi_score(ratio: float, freedom: int) -> float:
    """Return the normal score of ``ratio`` = sqrt(chi2 / k), k = ``freedom``."""
    if freedom == 0:
        return math.nan
    variance = 2.0 / (9.0 * freedom)
    return (math.pow(ratio, 2.0 / 3.0) - (1.0 - variance)) / math.sqrt(variance)
