"""Kernel that judges a match: its covariance by what residuals share, innovation, and fusion with the prediction."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.registration._covariance_kernels import fuse, innovate, match_covariance
from slammot_graph.registration._scatter_kernels import residual_scatter

INFORMATION, GRAPH, GAIN, CORRELATED, MATCH, FUSED, OF_MAP = range(7)
"""Rows of the matrices that `judge_match` fills."""


@kernel
def judge_match(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    points: FloatArray,
    is_used: BoolArray,
    lasers: FloatArray,
    T_predicted: FloatArray,
    cov_prior: FloatArray,
    cov_predicted: FloatArray,
    h: FloatArray,
    g: FloatArray,
    n_pairs: float,
    reach2: float,
    kernel_scale2: float,
    point_weight: float,
    max_gap: float,
    owner: "np.ndarray",
    keyframes: FloatArray,
    roots: FloatArray,
    residual_std: float,
    floor_std: float,
    noise_std: float,
    line_std: float,
    correlated_std_m: float,
    correlated_std_rad: float,
    kernel_scale: float,
    weak_ratio: float,
    fragile_pairs: float,
    T: FloatArray,
    T_free: FloatArray,
    innovation: FloatArray,
    map_scatter: FloatArray,
    out: FloatArray,
) -> tuple[int, float]:
    """Judge the match at `T` (3,); returns the number of its weak directions and the innovation's normalised square.

    Where it is weak `T` goes back to `T_predicted`, which has the covariances `cov_prior` in the match and
    `cov_predicted` relative to the anchor. Fills `T_free` and `innovation` (3,), the `map_scatter` of each keyframe
    (see `residual_scatter`), and `out` (7, 3, 3): `INFORMATION`, `GRAPH` and `GAIN` information and the `CORRELATED`
    covariance of `match_covariance`, the covariance of the `MATCH`, that of match and prediction `FUSED`, and the part
    that comes from the errors `OF_MAP`.
    """
    white, common, inherited = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    cov_independent = np.empty((3, 3))
    residual_scatter(
        map_points, map_normals, nearest, inv_cell, first, points, is_used, lasers, T, reach2, kernel_scale2,
        point_weight, max_gap, owner, keyframes, roots, white, common, inherited, map_scatter,
    )  # fmt: skip
    n_weak = match_covariance(
        points, is_used, T_predicted, T, h, g, white, common, inherited, n_pairs, residual_std, floor_std, noise_std,
        line_std, correlated_std_m, correlated_std_rad, kernel_scale, weak_ratio, fragile_pairs,
        T_free, out[INFORMATION], out[GRAPH], out[GAIN], cov_independent, out[CORRELATED], out[OF_MAP],
    )  # fmt: skip
    nis = innovate(T_predicted, T_free, cov_prior, out[GRAPH], out[INFORMATION], innovation, out[MATCH])
    fuse(cov_prior, cov_predicted, out[GAIN], cov_independent, out[OF_MAP], out[FUSED])
    return n_weak, nis if n_weak < 3 else np.nan
