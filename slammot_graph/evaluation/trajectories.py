"""Absolute and relative trajectory errors (ATE, RPE)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.evaluation.stats import ErrorStats, summarize


@dataclass(frozen=True, kw_only=True, eq=False)
class AbsoluteError:
    """Absolute trajectory error (ATE) after alignment.

    Attributes
    ----------
    translation_m, rotation_deg : ErrorStats
        Of the distances [m] and of the absolute angles [degrees] between the poses.
    T_world_map : (3,) array
        The alignment that was applied: map in world; the identity if none was asked for.
    """

    translation_m: ErrorStats
    rotation_deg: ErrorStats
    T_world_map: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RelativeError:
    """Relative pose error (RPE) over pairs of poses.

    Attributes
    ----------
    translation_m, rotation_deg : ErrorStats
    pairs : (n, 2) array of int
        Indices of the poses that were compared.
    """

    translation_m: ErrorStats
    rotation_deg: ErrorStats
    pairs: IntArray


def alignment(T_map_base: FloatArray, T_world_base: FloatArray) -> FloatArray:
    """Find the rigid transform that aligns one trajectory with another (Umeyama 1991, no scale, 2D).

    Parameters
    ----------
    T_map_base, T_world_base : (n, 3) arrays
        Estimated and true poses [m, m, rad]; only the positions count.

    Returns
    -------
    (3,) array ``T_world_map``; NaN for n = 0, and without rotation where the positions do not determine one.

    Raises
    ------
    InputError
        The trajectories differ in shape.
    """
    _check_same_shape(T_map_base, T_world_base)
    if len(T_map_base) == 0:
        return np.full(3, np.nan)
    map_mean, world_mean = T_map_base[:, :2].mean(axis=0), T_world_base[:, :2].mean(axis=0)
    p = T_map_base[:, :2] - map_mean
    q = T_world_base[:, :2] - world_mean
    sine = float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
    cosine = float(np.sum(p * q))
    theta = float(np.arctan2(sine, cosine))
    return np.array([*(world_mean - se2.rotation(theta) @ map_mean), theta])


def absolute_error(T_map_base: FloatArray, T_world_base: FloatArray, *, align: bool = True) -> AbsoluteError:
    """Compute the absolute trajectory error of poses that correspond one to one.

    Parameters
    ----------
    T_map_base : (n, 3) array
        Estimated poses [m, m, rad].
    T_world_base : (n, 3) array
        True poses.
    align : bool
        Align the estimate with the truth first (see `alignment`).

    Raises
    ------
    InputError
        The trajectories differ in shape.
    """
    _check_same_shape(T_map_base, T_world_base)
    T_world_map = alignment(T_map_base, T_world_base) if align else se2.IDENTITY.copy()
    T_base_true_base = se2.between(T_world_base, se2.compose(T_world_map[None, :], T_map_base))
    translation, rotation = error_sizes(T_base_true_base)
    return AbsoluteError(
        translation_m=summarize(translation), rotation_deg=summarize(rotation), T_world_map=T_world_map
    )


def relative_error(
    T_map_base: FloatArray,
    T_world_base: FloatArray,
    *,
    delta: float,
    unit: Literal["steps", "s", "m"] = "steps",
    stamps: FloatArray | None = None,
    overlap: bool = True,
) -> RelativeError:
    """Compute the relative pose error over pairs that lie `delta` apart.

    Each pair is a pose and the first later one at least `delta` away: in steps, in time, or along the
    true path.

    Parameters
    ----------
    T_map_base, T_world_base : (n, 3) arrays
        Estimated and true poses [m, m, rad].
    delta : float
        Distance of the pair, in `unit`.
    unit : "steps", "s" or "m"
    stamps : (n,) array, needed for "s"
        Times [s]; where they run backward the latest time so far counts.
    overlap : bool
        Start a pair at every pose; else each pair starts where the last one ended.

    Raises
    ------
    InputError
        The trajectories differ in shape, `delta` is not positive, or stamps are missing.
    """
    _check_same_shape(T_map_base, T_world_base)
    pairs = _pairs(T_world_base, delta, unit, stamps, overlap)
    i, j = pairs[:, 0], pairs[:, 1]
    true_step = se2.between(T_world_base[i], T_world_base[j])
    translation, rotation = error_sizes(se2.between(true_step, se2.between(T_map_base[i], T_map_base[j])))
    return RelativeError(translation_m=summarize(translation), rotation_deg=summarize(rotation), pairs=pairs)


def error_sizes(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths [m] and absolute angles [degrees] of error transforms (n, 3)."""
    return np.hypot(errors[:, 0], errors[:, 1]), np.degrees(np.abs(errors[:, 2]))


def path_length(T_map_base: FloatArray) -> float:
    """Path length [m] along poses (n, 3)."""
    return float(np.hypot(*np.diff(T_map_base[:, :2], axis=0).T).sum())


def _pairs(
    T_world_base: FloatArray, delta: float, unit: str, stamps: FloatArray | None, overlap: bool
) -> IntArray:
    if not delta > 0.0:
        raise InputError(f"the distance of relative errors must be positive, not {delta}")
    n = len(T_world_base)
    if unit == "steps":
        progress = np.arange(n, dtype=np.float64)
    elif unit == "m":
        steps = np.hypot(*np.diff(T_world_base[:, :2], axis=0).T)
        progress = np.concatenate([np.zeros(min(n, 1)), np.cumsum(steps)])
    else:
        if stamps is None or len(stamps) != n:
            raise InputError("relative errors over a time need one stamp per pose")
        progress = np.maximum.accumulate(stamps) if n else np.zeros(0)
    tolerance = 1e-9 * max(1.0, float(np.abs(progress).max(initial=0.0)))
    end = np.searchsorted(progress, progress + delta - tolerance)
    start = np.arange(n)
    if not overlap:
        chain = [0] if n else []
        while chain and end[chain[-1]] < n:
            chain.append(int(end[chain[-1]]))
        start = np.array(chain, dtype=np.int64)
    start = start[end[start] < n]
    return np.column_stack([start, end[start]]).astype(np.int64)


def _check_same_shape(T_map_base: FloatArray, T_world_base: FloatArray) -> None:
    shape = T_map_base.shape
    if shape != T_world_base.shape or len(shape) != 2 or shape[1] != 3:
        raise InputError(
            "trajectories to compare need the same shape (n, 3),"
            f" not {T_map_base.shape} and {T_world_base.shape}"
        )
