"""Consistency of covariances: NEES, its average with bounds, and the coverage of ellipses."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.evaluation.stats import ratio

_SIGMAS_95 = 1.959963984540054


@dataclass(frozen=True, kw_only=True)
class AverageNees:
    """Average normalised estimation error squared, and the interval of a consistent one.

    Attributes
    ----------
    n : int
        Samples; NaN samples are left out.
    dof : int
        Degrees of freedom of one sample: the expected average of a consistent estimate.
    anees : float
        Mean NEES; above `upper` the covariances are optimistic, below `lower` pessimistic.
    lower, upper : float
        Bounds of the 95% interval of a chi-square mean over the independent samples.
    """

    n: int
    dof: int
    anees: float
    lower: float
    upper: float

    @property
    def is_consistent(self) -> bool:
        """Whether the average lies within its bounds; False over nothing."""
        return self.lower <= self.anees <= self.upper


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Share of errors within their own ellipse.

    Attributes
    ----------
    n : int
    share : float
        Near to `probability` if the covariances are calibrated.
    lower, upper : float
        95% confidence interval of the share (Wilson), for independent samples.
    probability : float
    """

    n: int
    share: float
    lower: float
    upper: float
    probability: float


def pose_errors(T_map_base: FloatArray, T_map_base_true: FloatArray) -> FloatArray:
    """Errors of poses as right perturbations: ``log(inv(estimate) * truth)``, order (x, y, theta).

    Parameters
    ----------
    T_map_base, T_map_base_true : (n, 3) arrays
        Estimate and truth in one frame [m, m, rad].

    Returns
    -------
    (n, 3) array in the estimate's body frame [m, m, rad], as this package's covariances have it.
    """
    return se2.log(se2.between(T_map_base, T_map_base_true))


def nees(errors: FloatArray, cov: FloatArray) -> FloatArray:
    """Normalised estimation error squared ``e' inv(P) e``.

    Parameters
    ----------
    errors : (n, k) array
    cov : (n, k, k) array
        Covariances of `errors`, in the same frame and order.

    Returns
    -------
    (n,) array; NaN where the covariance is not positive definite.

    Raises
    ------
    InputError
        The shapes do not fit.
    """
    if errors.ndim != 2 or cov.shape != (*errors.shape, errors.shape[1]):
        raise InputError(f"errors of shape {errors.shape} do not fit covariances of shape {cov.shape}")
    result = np.full(len(errors), np.nan)
    is_finite = np.isfinite(cov).all(axis=(1, 2)) & np.isfinite(errors).all(axis=1)
    values, vectors = np.linalg.eigh(cov[is_finite])
    is_definite = (values > 0.0).all(axis=1)
    rotated = np.einsum("nji,nj->ni", vectors[is_definite], errors[is_finite][is_definite])
    result[np.flatnonzero(is_finite)[is_definite]] = np.sum(rotated**2 / values[is_definite], axis=1)
    return result


def average_nees(samples: FloatArray, *, dof: int, n_independent: int | None = None) -> AverageNees:
    """Average NEES with its 95% bounds (Bar-Shalom): those of ``chi2(n dof) / n``.

    Parameters
    ----------
    samples : array of any shape
        NEES values; NaN ones are left out.
    dof : int
        3 for poses, 2 for positions.
    n_independent : int, optional
        How many independent samples these are worth; by default all of them. Poses of one run are strongly
        correlated: take the number of runs.

    Returns
    -------
    AverageNees
        NaN over nothing.
    """
    values = samples[np.isfinite(samples)]
    n = values.size if n_independent is None else n_independent
    if values.size == 0 or n < 1:
        return AverageNees(n=0, dof=dof, anees=math.nan, lower=math.nan, upper=math.nan)
    return AverageNees(
        n=values.size,
        dof=dof,
        anees=float(values.mean()),
        lower=chi2_quantile(0.025, n * dof) / n,
        upper=chi2_quantile(0.975, n * dof) / n,
    )


def ellipse_coverage(errors: FloatArray, cov: FloatArray, *, probability: float = 0.95) -> Coverage:
    """Count the errors within the `probability` ellipse of their covariance.

    Parameters
    ----------
    errors : (n, k) array
    cov : (n, k, k) array
    probability : float

    Returns
    -------
    Coverage
        Samples whose covariance is not positive definite are left out; NaN over nothing.
    """
    samples = nees(errors, cov)
    samples = samples[np.isfinite(samples)]
    n = samples.size
    n_inside = int(np.count_nonzero(samples <= chi2_quantile(probability, errors.shape[1])))
    share = ratio(n_inside, n)
    z2 = _SIGMAS_95**2
    centre = ratio(n_inside + z2 / 2.0, n + z2) if n else math.nan
    half = _SIGMAS_95 * math.sqrt(share * (1.0 - share) * n + z2 / 4.0) / (n + z2) if n else math.nan
    return Coverage(n=n, share=share, lower=centre - half, upper=centre + half, probability=probability)


@dataclass(frozen=True, kw_only=True)
class RunConsistency:
    """Consistency of the covariances of one run; its scans depend on each other, so it has no bounds.

    Attributes
    ----------
    nis_mean : float
        Mean normalised innovation squared, 3 if prediction and match are consistent; NaN without matches. Above: the
        odometry or the matches are worse than their covariances say.
    nis_above_95 : float
        Share of the innovations beyond the 95% bound, 5% if consistent.
    relative_nees, relative_covered : float
        Mean NEES (3 if consistent) of the poses relative to their local map's anchor, and the share within their 95%
        ellipsoid; NaN without truth.
    map_nees, map_covered : float
        The same of the optimised poses in the map, which begins at the true start.
    """

    nis_mean: float
    nis_above_95: float
    relative_nees: float
    relative_covered: float
    map_nees: float
    map_covered: float


def run_consistency(result: RunResult) -> RunConsistency:
    """Evaluate a run's covariances by its innovations, and by the truth where the log has it."""
    nis = result.nis[np.isfinite(result.nis)]
    relative = in_map = (math.nan, math.nan)
    if result.T_world_base is not None:
        truth = result.T_world_base
        errors, is_matched = errors_to_anchor(result, truth)
        relative = nees_and_coverage(errors, result.cov_anchor_base[is_matched])
        T_map_world = se2.compose(result.T_map_base[0], se2.inverse(truth[0]))
        errors = pose_errors(result.T_map_base[1:], se2.compose(T_map_world[None, :], truth[1:]))
        in_map = nees_and_coverage(errors, result.cov_map[1:])
    return RunConsistency(
        nis_mean=float(nis.mean()) if nis.size else math.nan,
        nis_above_95=float((nis > chi2_quantile(0.95, 3)).mean()) if nis.size else math.nan,
        relative_nees=relative[0],
        relative_covered=relative[1],
        map_nees=in_map[0],
        map_covered=in_map[1],
    )


def errors_to_anchor(result: RunResult, T_world_base: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Errors (k, 3) of the poses relative to their local map's anchor, as of `pose_errors`.

    The second array (n,) is True for the scans that have one: those that were matched onto a local map.
    """
    anchors = result.anchor_scans
    is_matched = (anchors >= 0) & (anchors < len(T_world_base)) & (anchors != np.arange(len(T_world_base)))
    from_anchor = se2.between(T_world_base[anchors[is_matched]], T_world_base[is_matched])
    return pose_errors(result.T_anchor_base[is_matched], from_anchor), is_matched


def nees_and_coverage(errors: FloatArray, cov: FloatArray) -> tuple[float, float]:
    """Mean NEES of errors (n, k) under covariances (n, k, k), and the share within their 95% ellipsoid.

    NaN over nothing.
    """
    values = nees(errors, cov)
    values = values[np.isfinite(values)]
    if not values.size:
        return math.nan, math.nan
    return float(values.mean()), float((values <= chi2_quantile(0.95, errors.shape[1])).mean())


def chi2_quantile(probability: float, dof: float) -> float:
    """Quantile of the chi-square distribution; 5.99 for 95% and two degrees of freedom."""
    return 2.0 * float(gammaincinv(dof / 2.0, probability))
