"""R_r from a log: the odometry's noise, estimated from where odometry and matches disagree.

Over a window of scans i..j the odometry says that the robot moved by T_odom_i_j and the matches on one local map that
it moved by T_match_i_j. The residual ``log(inv(T_odom_i_j) * T_match_i_j)`` is the sum of the increments' errors, each
transformed into the window's last body frame, and of the matches' own. Its covariance is linear in the squares of the
parameters of `OdometryNoise`, which are found by maximum likelihood.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.stats import chi2

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.odometry.noise import OdometryNoise

PARAMETERS = tuple(item.name for item in fields(OdometryNoise))
"""In the order of `Windows.parts`."""

SCANS_PER_WINDOW = (1, 2, 5, 10, 20, 50)

MAX_WINDOWS = 4000
"""So many of each length are used, evenly spread over the log."""

MIN_WINDOWS = 30

STILL_SHARE = 0.1
"""Windows in which the robot stood make up at most this share: there the matches err alike and all agree too well."""

MOVES_M, MOVES_RAD = 0.01, 0.01
"""A window with less distance and less turn is one in which the robot stood."""

MIN_DISTANCE_M, MIN_TURN_RAD = 3.0, 3.0
"""A log with less of one motion cannot tell how the errors grow with it."""

LEAST_STILL = 5e-4
"""The still parts [m, rad] are not estimated smaller: they keep a standing robot's prediction from hardening."""

DEGREES_OF_FREEDOM = 4.0
"""Of Student's t: a slip that is far out counts little."""

LOG_SPREAD = math.log(3.0)
"""Standard deviation of a parameter's logarithm around its default, as far as the log does not know better."""

LOG_MATCH_SPREAD = math.log(2.0)

_LARGEST = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Windows of a log, and where odometry and matches disagree over each.

    Attributes
    ----------
    residuals : (n, 3) array
        From the odometry's motion to the matches' [m, m, rad], right perturbation (body frame of the last scan).
    parts : (n, 8, 3, 3) array
        Covariance of the odometry's motion for each parameter of `OdometryNoise` being 1 and the others 0.
    cov_match : (n, 3, 3) array
        Of the matches' motion; both in the same frame as the residuals.
    distance_m, turn_rad : (n,) arrays
        How much the robot drove and turned meanwhile, however often it turned back.
    n_scans : (n,) int array
        Number of increments.
    """

    residuals: FloatArray
    parts: FloatArray
    cov_match: FloatArray
    distance_m: FloatArray
    turn_rad: FloatArray
    n_scans: IntArray

    def __len__(self) -> int:
        return len(self.residuals)

    @property
    def is_moving(self) -> BoolArray:
        """(n,) windows in which the robot moved."""
        return (self.distance_m > MOVES_M) | (self.turn_rad > MOVES_RAD)

    def covariance(self, noise: OdometryNoise, match_scale: float = 1.0) -> FloatArray:
        """(n, 3, 3) covariances of the residuals under this noise; matches err `match_scale` times as they say."""
        squares = np.array([getattr(noise, name) for name in PARAMETERS]) ** 2
        cov = np.einsum("p,npij->nij", squares, self.parts) + match_scale**2 * self.cov_match
        return np.asarray(cov, dtype=np.float64)

    def take(self, rows: IntArray) -> "Windows":
        """Some of the windows."""
        return Windows(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The estimate and what it rests on.

    Attributes
    ----------
    noise : OdometryNoise
    kept : tuple of str
        Parameters that the log says too little about; they are the default's.
    n_windows : int
    n_windows_of : tuple of int
        For each parameter, the windows with the motion that it is about.
    distance_m, turn_rad : float
        Sums over the windows of one scan.
    match_scale : float
        The matches' errors were this many times what the matches say; 1 if they are consistent.
    spread_before, spread : float
        Median normalised squared residual over that of a consistent covariance, for the default noise and for the
        estimated; 1 if consistent, below if the covariance is pessimistic. NaN over nothing.
    """

    noise: OdometryNoise
    kept: tuple[str, ...]
    n_windows: int
    n_windows_of: tuple[int, ...]
    distance_m: float
    turn_rad: float
    match_scale: float
    spread_before: float
    spread: float


def cut_windows(
    T_odom_base: FloatArray,
    T_anchor_base: FloatArray,
    cov_independent: FloatArray,
    cov_correlated: FloatArray,
    anchors: IntArray,
    is_usable: BoolArray,
    lengths: Sequence[int] = SCANS_PER_WINDOW,
) -> Windows:
    """Cut a log of n scans into windows whose ends were matched on the same local map; they overlap by half.

    Parameters
    ----------
    T_odom_base : (n, 3) array
        Odometry of every scan.
    T_anchor_base : (n, 3) array
        Base as matched, in the frame of the local map's anchor, and free of the odometry.
    cov_independent, cov_correlated : (n, 3, 3) arrays
        Covariance of `T_anchor_base` (body frame), apart into what is each match's own and what neighbouring matches
        share; of a window, both ends' own part counts and the shared one once, for it cancels by half or more.
    anchors : (n,) int array
        Scan index of the anchor; negative where there is none.
    is_usable : (n,) bool array
        The match converged. A window may have other scans between its ends.
    lengths : sequence of int
        Numbers of increments.
    """
    found = [
        _windows_of(length, T_odom_base, T_anchor_base, cov_independent, cov_correlated, anchors, is_usable)
        for length in lengths
    ]
    return Windows(
        **{item.name: np.concatenate([getattr(w, item.name) for w in found]) for item in fields(Windows)}
    )


def calibrate(windows: Windows, default: OdometryNoise | None = None) -> Calibration:
    """Estimate the odometry's noise by maximum likelihood.

    The random and the still parts of the increments add up, each transformed into the window's last frame, as the
    pipeline compounds them. The ratio parts are systematic: one error of scale for the whole window, so their standard
    deviation grows with the distance driven and the turn (a turn back undoes it), as
    `OdometryNoise.covariance` has it for one increment as long as the window. The pipeline compounds increments as
    independent, so there the ratio parts count for less the shorter the increments are.

    Residuals follow Student's t, scaled so that Gaussian ones get their own covariance: slips hardly count. The
    matches' covariance is estimated up to a factor. A parameter that the log knows nothing of stays near the default,
    two that it cannot tell apart keep their ratio: each logarithm has a wide Gaussian around the default's.

    Parameters
    ----------
    windows : Windows
    default : OdometryNoise, optional
        Where to start, and what holds for kinds of motion of which there is too little.

    Raises
    ------
    InputError
        Fewer than `MIN_WINDOWS` windows.
    """
    default = OdometryNoise() if default is None else default
    if len(windows) < MIN_WINDOWS:
        raise InputError(f"windows of scans matched on one local map: {len(windows)}, needed: {MIN_WINDOWS}")
    single = windows.n_scans == windows.n_scans.min()
    distance_m, turn_rad = float(windows.distance_m[single].sum()), float(windows.turn_rad[single].sum())
    kept = tuple(
        name
        for name in PARAMETERS
        if (_is_of_distance(name) and distance_m < MIN_DISTANCE_M)
        or (_is_of_turn(name) and turn_rad < MIN_TURN_RAD)
    )
    sample = windows.take(_sampled(windows))
    noise, match_scale = _fit(sample, default, kept)
    return Calibration(
        noise=noise,
        kept=kept,
        n_windows=len(sample),
        n_windows_of=tuple(_count(sample, name) for name in PARAMETERS),
        distance_m=distance_m,
        turn_rad=turn_rad,
        match_scale=match_scale,
        spread_before=_spread(sample, default, match_scale),
        spread=_spread(sample, noise, match_scale),
    )


def _windows_of(
    length: int,
    T_odom_base: FloatArray,
    T_anchor_base: FloatArray,
    cov_independent: FloatArray,
    cov_correlated: FloatArray,
    anchors: IntArray,
    is_usable: BoolArray,
) -> Windows:
    first = np.arange(0, max(len(anchors) - length, 0), max(1, length // 2))
    last = first + length
    fits = (anchors[first] == anchors[last]) & (anchors[first] >= 0) & is_usable[first] & is_usable[last]
    first, last = first[fits], last[fits]
    T_odom, T_match = (se2.between(T[first], T[last]) for T in (T_odom_base, T_anchor_base))
    back = se2.adjoint(se2.inverse(T_match))
    cov_match = (
        back @ cov_independent[first] @ np.swapaxes(back, -1, -2)
        + cov_independent[last]
        + cov_correlated[last]
    )
    # each increment's error, transformed into the frame of the window's last scan
    scans = first[:, None] + np.arange(length + 1)
    poses = T_odom_base[scans]
    increments = se2.between(poses[:, :-1], poses[:, 1:])
    carry = se2.adjoint(se2.inverse(se2.between(poses[:, 1:], poses[:, -1:])))
    distance_m, turn_rad = np.hypot(increments[..., 0], increments[..., 1]), np.abs(increments[..., 2])
    return Windows(
        residuals=se2.log(se2.between(T_odom, T_match)),
        parts=_parts(increments, carry, distance_m, turn_rad),
        cov_match=cov_match,
        distance_m=distance_m.sum(axis=1),
        turn_rad=turn_rad.sum(axis=1),
        n_scans=np.full(len(first), length),
    )


def _parts(
    increments: FloatArray, carry: FloatArray, distance_m: FloatArray, turn_rad: FloatArray
) -> FloatArray:
    """(n, 8, 3, 3) unit covariances of windows of k increments (n, k, 3) with adjoints `carry` (n, k, 3, 3)."""
    of_m = carry[..., :2] @ np.swapaxes(carry[..., :2], -1, -2)
    of_rad = carry[..., 2:] @ np.swapaxes(carry[..., 2:], -1, -2)

    def added(unit: FloatArray, weights: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nk,nkij->nij", weights, unit), dtype=np.float64)

    nothing, ones = np.zeros_like(distance_m), np.ones_like(distance_m)
    along = np.stack([increments[..., 0], increments[..., 1], nothing], axis=-1)
    aside = np.stack([-increments[..., 1], increments[..., 0], nothing], axis=-1)
    turned = np.stack([nothing, nothing, increments[..., 2]], axis=-1)
    scaled = [np.einsum("nkij,nkj->ni", carry, error) for error in (along, aside, turned)]
    squares = [error[:, :, None] * error[:, None, :] for error in scaled]
    parts = {
        "still_std_m": added(of_m, ones),
        "still_std_rad": added(of_rad, ones),
        "std_m_per_sqrt_m": added(of_m, distance_m),
        "std_rad_per_sqrt_m": added(of_rad, distance_m),
        "std_m_per_sqrt_rad": added(of_m, turn_rad),
        "std_rad_per_sqrt_rad": added(of_rad, turn_rad),
        "ratio_m_per_m": squares[0] + squares[1],
        "ratio_rad_per_rad": squares[2],
    }
    return np.stack([parts[name] for name in PARAMETERS], axis=1)


def _is_of_distance(name: str) -> bool:
    return name in ("std_m_per_sqrt_m", "std_rad_per_sqrt_m", "ratio_m_per_m")


def _is_of_turn(name: str) -> bool:
    return name in ("std_m_per_sqrt_rad", "std_rad_per_sqrt_rad", "ratio_rad_per_rad")


def _count(windows: Windows, name: str) -> int:
    if _is_of_distance(name):
        return int(np.count_nonzero(windows.distance_m > MOVES_M))
    if _is_of_turn(name):
        return int(np.count_nonzero(windows.turn_rad > MOVES_RAD))
    return len(windows)


def _sampled(windows: Windows) -> IntArray:
    """Rows of the windows to use: evenly spread, and not too many in which the robot stood."""
    rows: list[IntArray] = []
    for length in np.unique(windows.n_scans):
        moving, still = (
            np.flatnonzero((windows.n_scans == length) & is_of_kind)
            for is_of_kind in (windows.is_moving, ~windows.is_moving)
        )
        moving = _thinned(moving, MAX_WINDOWS)
        n_still = math.ceil(STILL_SHARE * len(moving)) if windows.is_moving.any() else MAX_WINDOWS
        rows += [moving, _thinned(still, n_still)]
    return np.concatenate(rows)


def _thinned(rows: IntArray, n: int) -> IntArray:
    return rows if len(rows) <= n else rows[np.linspace(0, len(rows) - 1, n).round().astype(np.int64)]


def _fit(windows: Windows, default: OdometryNoise, kept: tuple[str, ...]) -> tuple[OdometryNoise, float]:
    """Find the noise and the factor on the matches' errors."""
    centre = np.log([max(getattr(default, name), LEAST_STILL) for name in PARAMETERS])
    is_free = np.array([name not in kept for name in PARAMETERS])
    fixed = np.array([getattr(default, name) ** 2 for name in PARAMETERS]) * ~is_free
    base = np.einsum("p,npij->nij", fixed, windows.parts)
    parts = np.concatenate([windows.parts[:, is_free], windows.cov_match[:, None]], axis=1)
    start = np.append(centre[is_free], 0.0)
    spread = np.append(np.full(len(start) - 1, LOG_SPREAD), LOG_MATCH_SPREAD)
    stretch = _stretch(DEGREES_OF_FREEDOM)

    def cost(logs: FloatArray) -> tuple[float, FloatArray]:
        squares = np.exp(2.0 * logs)
        cov = base + np.einsum("p,npij->nij", squares, parts)
        inverse = np.linalg.inv(cov)
        pull = np.einsum("nij,nj->ni", inverse, windows.residuals)
        normalised = np.einsum("ni,ni->n", pull, windows.residuals)
        inner = DEGREES_OF_FREEDOM + stretch * normalised
        away = (logs - start) / spread
        value = 0.5 * np.linalg.slogdet(cov)[1].sum()
        value += 0.5 * (DEGREES_OF_FREEDOM + 3.0) * np.log(inner).sum() + 0.5 * np.sum(away**2)
        weights = (DEGREES_OF_FREEDOM + 3.0) * stretch / inner
        slope = 0.5 * np.einsum("nij,npji->p", inverse, parts)
        slope -= 0.5 * np.einsum("n,ni,npij,nj->p", weights, pull, parts, pull, optimize=True)
        return float(value), 2.0 * squares * slope + away / spread

    least = [LEAST_STILL if "still" in name else 1e-6 for name in np.array(PARAMETERS)[is_free]]
    bounds = [(math.log(low), math.log(_LARGEST)) for low in least] + [(math.log(0.2), math.log(5.0))]
    found = np.exp(minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds).x)
    free = (name for name in PARAMETERS if name not in kept)
    values = {name: float(value) for name, value in zip(free, found, strict=False)}
    return OdometryNoise(**{name: values.get(name, getattr(default, name)) for name in PARAMETERS}), float(
        found[-1]
    )


def _stretch(dof: float) -> float:
    """Factor on the normalised squares in Student's likelihood that makes it right for Gaussian residuals.

    The likelihood's slope in the scale of the covariance, ``E[(dof + 3) k m / (dof + k m)] - 3`` with m of chi-square
    with 3 degrees of freedom, is zero at the true scale for this k.
    """
    m = chi2.ppf((np.arange(2000) + 0.5) / 2000, 3)
    return float(brentq(lambda k: np.mean((dof + 3.0) * k * m / (dof + k * m)) - 3.0, 0.5, 5.0))


def _spread(windows: Windows, noise: OdometryNoise, match_scale: float) -> float:
    cov = windows.covariance(noise, match_scale)
    normalised = np.einsum(
        "ni,ni->n", windows.residuals, np.linalg.solve(cov, windows.residuals[..., None])[..., 0]
    )
    return float(np.median(normalised) / chi2.ppf(0.5, 3)) if len(normalised) else math.nan
