"""Which of both is the noisier, the odometry or the matches, from how their differences follow each other.

The difference of the increments that two matches and the odometry tell is ``e_k = w_k + v_k - v_(k-1)``, with the
odometry's error w and the matches' v. Neighbouring differences have the covariance ``-var(v)``, and the sum of n of
them has the variance ``n var(w) + 2 var(v)`` (as in Allan's variance). A match that pulls the next ones along, as they
meet in the same local map, makes the sum larger and the covariance less negative: what is found of the odometry is an
upper bound, of the matches a lower one.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slammot_graph.core.checks import AtLeastOne, Checked, Count, NotNegative, Positive, PositiveShare
from slammot_graph.core.types import FloatArray

WINDOWS = (4, 8, 16)
"""Lengths of the sums in differences; the one that tells of the most noise counts."""


@dataclass(frozen=True, kw_only=True)
class InnovationNoiseConfig(Checked):
    """When the noise of odometry and matches is taken from their differences.

    Attributes
    ----------
    n_kept, n_first, n_between : int
        The latest so many differences are used, once there are `n_first`, anew after a quarter as many
        more, at most `n_between`.
    n_sigma : float
        The matches must be noisier than they claim by so many standard deviations of the estimate, and the odometry
        counts as so many worse than its estimate.
    min_still : float
        Without what grows with the motion, the differences must tell of so much of the claimed variance: odometry that
        is read too early or too late differs to and fro as well, in proportion to the motion.
    clip : float
        A difference counts for no more than this times the robust standard deviation.
    min_scale : float
        Lower bound of the scale of the odometry's standard deviation.
    max_match_scale : float
        Upper bound of that of the matches.
    """

    n_kept: Count = 256
    n_first: Count = 32
    n_between: Count = 128
    n_sigma: Positive = 2.0
    min_still: NotNegative = 0.5
    clip: Positive = 4.0
    min_scale: PositiveShare = 0.05
    max_match_scale: AtLeastOne = 5.0


class _Fitted(NamedTuple):
    """What differences tell of translation, or of rotation.

    Attributes
    ----------
    products : (n - 1, axes) array
        Of neighbours, the sign changed, over the variance that a match claims: their mean estimates the ratio.
    of_still : float
        Their mean at no motion: what does not grow with it.
    of_odometry : float
        Scale of the odometry's standard deviation.
    """

    products: FloatArray
    of_still: float
    of_odometry: float


class InnovationNoise:
    """Gathers the differences, and tells the scales of both standard deviations.

    Attributes
    ----------
    config : InnovationNoiseConfig
    is_refuted : bool
        The matches are noisier than they claim, translation and rotation.
    match_scale : float
        Of the matches' standard deviations over what they claim, the larger of translation and rotation; 1 unless the
        differences refute both claims.
    scales : (float, float)
        Of the odometry's standard deviations over its model's, translation and rotation, at most 1; less only where
        both claims of the matches are refuted.
    """

    def __init__(self, config: InnovationNoiseConfig) -> None:
        self.config = config
        self.is_refuted = False
        self.match_scale = 1.0
        self.scales = (1.0, 1.0)
        self._rows = np.zeros((config.n_kept, 9))
        self._n = 0
        self._next_fit = config.n_first

    def add(
        self,
        difference: FloatArray,
        told: FloatArray,
        model: tuple[float, float],
        claimed: tuple[float, float],
    ) -> None:
        """Take in the next difference.

        Parameters
        ----------
        difference : (3,) array
            Increment between two matches less that of the odometry [m, m, rad].
        told : (3,) array
            The odometry's increment.
        model, claimed : (m^2, rad^2)
            Variance of the odometry's increment, and of one match, translation per axis and rotation.
        """
        config = self.config
        x, y, turn = told.tolist()
        self._rows[self._n % config.n_kept] = (
            *difference.tolist(),
            *model,
            *claimed,
            math.hypot(x, y),
            abs(turn),
        )
        self._n += 1
        if self._n >= self._next_fit:
            self.fit()
            self._next_fit = self._n + min(max(self._n // 4, 8), config.n_between)

    def fit(self) -> None:
        """Estimate both noises from the differences kept."""
        n, kept = self._n, self.config.n_kept
        rows = self._rows[:n] if n <= kept else np.roll(self._rows, -(n % kept), axis=0)
        translation = self._fitted(rows[:, 0:2], rows[:, 3], rows[:, 5], rows[:, 7])
        rotation = self._fitted(rows[:, 2:3], rows[:, 4], rows[:, 6], rows[:, 8])
        products = np.concatenate([translation.products.ravel(), rotation.products.ravel()])
        mean = float(products.mean())
        margin = self.config.n_sigma * float(products.std()) / math.sqrt(products.size)
        of_matches = [float(part.products.mean()) for part in (translation, rotation)]
        is_still_noisy = min(translation.of_still, rotation.of_still) > self.config.min_still
        if self.is_refuted:
            self.is_refuted = is_still_noisy and mean + margin > 1.0
        else:
            self.is_refuted = is_still_noisy and mean - margin > 1.0 and min(of_matches) > 1.0
        self.match_scale, self.scales = 1.0, (1.0, 1.0)
        if self.is_refuted:
            self.match_scale = min(math.sqrt(max(*of_matches, 1.0)), self.config.max_match_scale)
            self.scales = translation.of_odometry, rotation.of_odometry

    def _fitted(
        self, errors: FloatArray, model: FloatArray, claimed: FloatArray, moved: FloatArray
    ) -> "_Fitted":
        """Noise of both from differences (n, axes) in motions of a size (n,)."""
        config = self.config
        errors = errors - np.median(errors, axis=0)
        limit = config.clip * 1.4826 * np.median(np.abs(errors), axis=0)
        errors = np.clip(errors, -limit, limit)
        products = -errors[1:] * errors[:-1]
        mean_claimed = max(float(claimed.mean()), 1e-12)
        sums = np.vstack([np.zeros(errors.shape[1]), np.cumsum(errors, axis=0)])
        mean_model = max(float(model.mean()), 1e-12)
        worst = 0.0
        for size in WINDOWS:
            squares = np.square(sums[size:] - sums[:-size])
            n_free = errors.size / size
            upper = 1.0 + config.n_sigma * np.sqrt(2.0 / n_free)
            worst = max(worst, upper * float(squares.mean()) / (size * mean_model))
        return _Fitted(
            products=products / mean_claimed,
            of_still=_without_motion(products.mean(axis=1), moved[1:] + moved[:-1], config.n_sigma)
            / mean_claimed,
            of_odometry=float(np.clip(math.sqrt(worst), config.min_scale, 1.0)),
        )


def _without_motion(products: FloatArray, moved: FloatArray, n_sigma: float) -> float:
    """Value at no motion of products (n,) that grow with the square of the motion (n,).

    Their mean where they do not clearly grow, by `n_sigma` standard deviations of the slope.
    """
    squared = np.square(moved) / max(float(np.square(moved).mean()), 1e-12)
    weights = np.square(1.0 / (0.3 + squared))
    weight = float(weights.sum())
    mean, centre = float(weights @ products) / weight, float(weights @ squared) / weight
    off = weights * (squared - centre)
    varied = max(float(off @ (squared - centre)), 1e-3 * weight)
    slope = float(off @ products) / varied
    residuals = products - mean - slope * (squared - centre)
    if slope <= n_sigma * float(np.linalg.norm(off * residuals)) / varied:
        return float(products.mean())
    return mean - slope * centre
