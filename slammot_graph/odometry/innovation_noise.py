"""Which of both is the noisier, the odometry or the matches, from how their differences follow each other.

The difference of the increments that two matches and the odometry tell is ``e_k = w_k + v_k - v_(k-1)``, with the
odometry's error w and the matches' v. Neighbouring differences have the covariance ``-var(v)``, and the sum of n of
them has the variance ``n var(w) + 2 var(v)`` (as in Allan's variance). A match that pulls the next ones along, as they
meet in the same local map, makes the sum larger and the covariance less negative: what is found of the odometry is an
upper bound, of the matches a lower one.
"""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core.checks import AtLeastOne, Checked, Count, Positive, PositiveShare
from slammot_graph.core.types import FloatArray

WINDOWS = (4, 8, 16)
"""Lengths of the sums in differences; the one that tells of the most noise counts."""


@dataclass(frozen=True, kw_only=True)
class InnovationNoiseConfig(Checked):
    """When the noise of odometry and matches is taken from their differences.

    Attributes
    ----------
    n_kept, n_first, n_between : int
        The latest so many differences are used, once there are `n_first`, anew after every `n_between`.
    n_sigma : float
        The matches must be noisier than they claim by so many standard deviations of the estimate, and the odometry
        counts as so many worse than its estimate.
    clip : float
        A difference counts for no more than this times the robust standard deviation.
    min_scale : float
        Lower bound of the scale of the odometry's standard deviation.
    max_match_scale : float
        Upper bound of that of the matches.
    """

    n_kept: Count = 256
    n_first: Count = 32
    n_between: Count = 16
    n_sigma: Positive = 2.0
    clip: Positive = 4.0
    min_scale: PositiveShare = 0.05
    max_match_scale: AtLeastOne = 5.0


class InnovationNoise:
    """Gathers the differences, and tells the scales of both standard deviations.

    Attributes
    ----------
    config : InnovationNoiseConfig
    match_scale : float
        Of the matches' standard deviations over what they claim, the larger of translation and rotation; 1 unless the
        differences refute both claims.
    scales : (float, float)
        Of the odometry's standard deviations over its model's, translation and rotation, at most 1; less only where
        both claims of the matches are refuted.
    """

    def __init__(self, config: InnovationNoiseConfig) -> None:
        self.config = config
        self.match_scale = 1.0
        self.scales = (1.0, 1.0)
        self._rows = np.zeros((config.n_kept, 7))
        self._n = 0

    def add(self, difference: FloatArray, model: tuple[float, float], claimed: tuple[float, float]) -> None:
        """Take in the next difference.

        Parameters
        ----------
        difference : (3,) array
            Increment between two matches less that of the odometry [m, m, rad].
        model, claimed : (m^2, rad^2)
            Variance of the odometry's increment, and of one match, translation per axis and rotation.
        """
        config = self.config
        self._rows[self._n % config.n_kept] = (*difference.tolist(), *model, *claimed)
        self._n += 1
        if self._n >= config.n_first and self._n % config.n_between == 0:
            self.fit()

    def fit(self) -> None:
        """Estimate both noises from the differences kept."""
        n, kept = self._n, self.config.n_kept
        rows = self._rows[:n] if n <= kept else np.roll(self._rows, -(n % kept), axis=0)
        of_matches_m, of_odometry_m = self._fitted(rows[:, 0:2], rows[:, 3], rows[:, 5])
        of_matches_rad, of_odometry_rad = self._fitted(rows[:, 2:3], rows[:, 4], rows[:, 6])
        is_refuted = of_matches_m > 1.0 and of_matches_rad > 1.0
        self.scales = (of_odometry_m, of_odometry_rad) if is_refuted else (1.0, 1.0)
        self.match_scale = max(of_matches_m, of_matches_rad) if is_refuted else 1.0

    def _fitted(self, errors: FloatArray, model: FloatArray, claimed: FloatArray) -> tuple[float, float]:
        """Scales of the matches' and of the odometry's standard deviation from differences (n, axes)."""
        config = self.config
        errors = errors - np.median(errors, axis=0)
        limit = config.clip * 1.4826 * np.median(np.abs(errors), axis=0)
        errors = np.clip(errors, -limit, limit)
        products = -errors[1:] * errors[:-1]
        mean_claimed = max(float(claimed.mean()), 1e-12)
        std = float(products.std()) / np.sqrt(products.size)
        of_matches = float(products.mean()) / mean_claimed
        if of_matches - config.n_sigma * std / mean_claimed <= 1.0:
            of_matches = 1.0
        sums = np.vstack([np.zeros(errors.shape[1]), np.cumsum(errors, axis=0)])
        mean_model = max(float(model.mean()), 1e-12)
        worst = 0.0
        for size in WINDOWS:
            squares = np.square(sums[size:] - sums[:-size])
            n_free = errors.size / size
            upper = 1.0 + config.n_sigma * np.sqrt(2.0 / n_free)
            worst = max(worst, upper * float(squares.mean()) / (size * mean_model))
        return (
            min(float(np.sqrt(of_matches)), config.max_match_scale),
            float(np.clip(np.sqrt(worst), config.min_scale, 1.0)),
        )
