"""Kernels of a match's covariance: what its residuals tell, and how it is fused with the prediction."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.linalg import BARELY, eigh3, invert3, invert_lower, sandwich3
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.registration._solve_kernels import solve3


@kernel
def match_covariance(
    points: FloatArray,
    is_used: BoolArray,
    T_prior: FloatArray,
    T: FloatArray,
    h: FloatArray,
    g: FloatArray,
    white: FloatArray,
    common: FloatArray,
    inherited: FloatArray,
    n_pairs: float,
    residual_std: float,
    floor_std: float,
    noise_std: float,
    line_std: float,
    correlated_std_m: float,
    correlated_std_rad: float,
    outlier_std: float,
    weak_ratio: float,
    fragile_pairs: float,
    T_free: FloatArray,
    information: FloatArray,
    graph_information: FloatArray,
    gain_information: FloatArray,
    cov_independent: FloatArray,
    cov_correlated: FloatArray,
    cov_map: FloatArray,
) -> int:
    """Split a match into strong and weak directions; returns the number of weak ones.

    Directions are eigenvectors of the normal matrix `h`, the rotation scaled by the points' root mean square
    distance. In weak ones `T` goes back to `T_prior`. `T_free` gets the optimum of the match alone in the strong ones.
    There the covariance has three parts: `cov_independent` of the beams' own noise, ``noise_std^2 inv(h) white inv(h)``
    (Censi), `cov_correlated` of what the beams of one line and all beams have in common, and `cov_map` of the map's
    keyframes and of directions that few pairs determine.
    `information` gets the inverse of all but what the keyframes bring, `graph_information` the cautious
    ``1 / (residual_std^2 / eigenvalue + floor_std^2)`` of each direction, `gain_information` the same without floor.
    """
    total = 0.0
    n = 0
    for k in range(points.shape[0]):
        if is_used[k]:
            total += points[k, 0] ** 2 + points[k, 1] ** 2
            n += 1
    lever = math.sqrt(total / max(n, 1))
    scale = np.array([1.0, 1.0, 1.0 / lever])
    values = np.empty(3)
    vectors = np.empty((3, 3))
    scaled = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            scaled[i, j] = h[i, j] * (scale[i] * scale[j])
    eigh3(scaled, values, vectors)
    # the scaled tangent is (x, y, lever * theta)
    c = math.cos(T_prior[2])
    s = math.sin(T_prior[2])
    ex = T[0] - T_prior[0]
    ey = T[1] - T_prior[1]
    moved = np.empty(3)
    moved[0] = c * ex + s * ey
    moved[1] = -s * ex + c * ey
    moved[2] = (T[2] - T_prior[2] + math.pi) % (2.0 * math.pi) - math.pi
    kept = np.zeros(3)
    free = np.zeros(3)
    n_weak = 0
    # columns: the strong directions, scaled, over their eigenvalue
    back = np.zeros((3, 3))
    forth = np.zeros((3, 3))
    for m in range(3):
        if not values[m] > weak_ratio * n_pairs:
            n_weak += 1
            continue
        along = 0.0
        slope = 0.0
        for i in range(3):
            along += vectors[i, m] * moved[i] / scale[i]
            slope += vectors[i, m] * scale[i] * g[i]
        for i in range(3):
            kept[i] += vectors[i, m] * scale[i] * along
            free[i] -= vectors[i, m] * scale[i] * slope / values[m]
            back[i, m] = vectors[i, m] * scale[i]
            forth[i, m] = vectors[i, m] / scale[i]
    own_part = np.zeros((3, 3))
    common_part = np.zeros((3, 3))
    map_part = np.zeros((3, 3))
    for m in range(3):
        for k in range(3):
            if back[0, m] == 0.0 and back[1, m] == 0.0 and back[2, m] == 0.0:
                continue
            if back[0, k] == 0.0 and back[1, k] == 0.0 and back[2, k] == 0.0:
                continue
            a = 0.0
            b = 0.0
            d = 0.0
            for i in range(3):
                for j in range(3):
                    a += back[i, m] * white[i, j] * back[j, k]
                    b += back[i, m] * common[i, j] * back[j, k]
                    d += back[i, m] * inherited[i, j] * back[j, k]
            own_part[m, k] = noise_std**2 * a / (values[m] * values[k])
            common_part[m, k] = line_std**2 * b / (values[m] * values[k])
            map_part[m, k] = d / (values[m] * values[k])
    for m in range(3):
        if not values[m] > weak_ratio * n_pairs:
            continue
        map_part[m, m] += (outlier_std * (fragile_pairs / values[m]) ** 2) ** 2
        for k in range(3):
            if values[k] > weak_ratio * n_pairs:
                for i in range(3):
                    std = correlated_std_rad * lever if i == 2 else correlated_std_m
                    common_part[m, k] += std**2 * vectors[i, m] * vectors[i, k]
    sandwich3(back, common_part, cov_correlated)
    sandwich3(back, map_part, cov_map)
    sandwich3(back, own_part, cov_independent)
    whole = own_part + common_part
    for m in range(3):
        if values[m] > weak_ratio * n_pairs:
            whole[m, m] += (outlier_std * (fragile_pairs / values[m]) ** 2) ** 2
    cautious = np.zeros((3, 3))
    gain = np.zeros((3, 3))
    for m in range(3):
        if values[m] > weak_ratio * n_pairs:
            cautious[m, m] = 1.0 / (residual_std**2 / values[m] + floor_std**2)
            gain[m, m] = values[m] / residual_std**2
        else:
            whole[m, m] = 1.0
    if not invert3(whole, scaled):
        scaled[:] = 0.0
    sandwich3(forth, scaled, information)
    sandwich3(forth, cautious, graph_information)
    sandwich3(forth, gain, gain_information)
    if n_weak > 0:
        T[0] = T_prior[0] + c * kept[0] - s * kept[1]
        T[1] = T_prior[1] + s * kept[0] + c * kept[1]
        T[2] = (T_prior[2] + kept[2] + math.pi) % (2.0 * math.pi) - math.pi
    c = math.cos(T[2])
    s = math.sin(T[2])
    T_free[0] = T[0] + c * free[0] - s * free[1]
    T_free[1] = T[1] + s * free[0] + c * free[1]
    T_free[2] = (T[2] + free[2] + math.pi) % (2.0 * math.pi) - math.pi
    return n_weak


@kernel
def innovate(
    T_predicted: FloatArray,
    T_match: FloatArray,
    cov_predicted: FloatArray,
    graph_information: FloatArray,
    information: FloatArray,
    innovation: FloatArray,
    cov: FloatArray,
) -> float:
    """Fill the `innovation` (3,) ``log(inverse(T_predicted) T_match)`` and `cov` (3, 3) of a match's information.

    Returns the innovation's normalised square, for the sum of the prediction's and the match's cautious covariance.
    """
    c = math.cos(T_predicted[2])
    s = math.sin(T_predicted[2])
    dx = T_match[0] - T_predicted[0]
    dy = T_match[1] - T_predicted[1]
    turn = (T_match[2] - T_predicted[2] + math.pi) % (2.0 * math.pi) - math.pi
    half = 0.5 * turn
    a = 1.0 - half * half / 3.0 if abs(turn) < 1e-6 else half / math.tan(half)
    x = c * dx + s * dy
    y = -s * dx + c * dy
    innovation[0] = a * x + half * y
    innovation[1] = -half * x + a * y
    innovation[2] = turn
    barely = np.empty((3, 3))
    whole = np.empty((3, 3))
    inverse = np.empty((3, 3))
    nis = np.nan
    for i in range(3):
        for j in range(3):
            barely[i, j] = graph_information[i, j] + (BARELY if i == j else 0.0)
    if invert3(barely, inverse):
        for i in range(3):
            for j in range(3):
                whole[i, j] = cov_predicted[i, j] + inverse[i, j]
        if invert3(whole, inverse):
            nis = 0.0
            for i in range(3):
                for j in range(3):
                    nis += innovation[i] * inverse[i, j] * innovation[j]
    for i in range(3):
        for j in range(3):
            barely[i, j] = information[i, j] + (BARELY if i == j else 0.0)
    if not invert3(barely, cov):
        cov[:] = np.nan
    return nis


@kernel
def fuse(
    cov_prior: FloatArray,
    cov_predicted: FloatArray,
    gain_information: FloatArray,
    cov_independent: FloatArray,
    cov_map: FloatArray,
    out: FloatArray,
) -> None:
    """Covariance `out` (3, 3) of a prediction and a match taken together (Joseph's form).

    The gain is what the solver gave the scan against the prior, `cov_independent` the noise that the scan had. Nothing
    is known better than the map: `out` is raised to `cov_map` where it is below.
    """
    whole = np.empty((3, 3))
    invert3(cov_prior, whole)
    gain = np.empty((3, 3))
    kept = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            whole[i, j] += gain_information[i, j]
    for j in range(3):
        solve3(whole, gain_information[:, j], gain[j])  # row j of the transpose
    for i in range(3):
        for j in range(i):
            gain[i, j], gain[j, i] = gain[j, i], gain[i, j]
    for i in range(3):
        for j in range(3):
            kept[i, j] = (1.0 if i == j else 0.0) - gain[i, j]
    fused = np.empty((3, 3))
    noise = np.empty((3, 3))
    sandwich3(kept, cov_predicted, fused)
    sandwich3(gain, cov_independent, noise)
    for i in range(3):
        for j in range(3):
            fused[i, j] += noise[i, j]
    # its Cholesky factor, and the inverse of that
    root = np.zeros((3, 3))
    back = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            rest = 0.5 * (fused[i, j] + fused[j, i])
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(rest, 1e-15 * fused[i, i]))
            else:
                root[i, j] = rest / root[j, j]
    invert_lower(root, back)
    values = np.empty(3)
    vectors = np.empty((3, 3))
    sandwich3(back, cov_map, noise)
    eigh3(noise, values, vectors)
    for i in range(3):
        for j in range(3):
            kept[i, j] = root[i, 0] * vectors[0, j] + root[i, 1] * vectors[1, j] + root[i, 2] * vectors[2, j]
    for i in range(3):
        for j in range(3):
            out[i, j] = 0.0
            for k in range(3):
                out[i, j] += kept[i, k] * max(values[k], 1.0) * kept[j, k]
