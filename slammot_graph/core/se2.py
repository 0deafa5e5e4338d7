"""Batched SE(2): robot poses and rigid transforms as (..., 3) arrays of x [m], y [m], theta [rad].

Tangent vectors are (x, y, theta) and perturb on the right, in the body frame, as GTSAM's ``Pose2`` does:
``T.retract(v) = compose(T, exp(v))``. Every covariance in this package is of that right perturbation
unless its name says otherwise.
"""

import math

import numpy as np
import numpy.typing as npt

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray

IDENTITY: FloatArray = np.zeros(3)
IDENTITY.setflags(write=False)


def wrap_angle(angle: npt.ArrayLike) -> FloatArray:
    """Wrap angles [rad] of any shape into [-pi, pi)."""
    return (np.asarray(angle, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi


def compose(T_a_b: FloatArray, T_b_c: FloatArray) -> FloatArray:
    """Compose two transforms: ``T_a_c = T_a_b * T_b_c`` (the paper's RG, eq. 1, 2 and 8).

    Parameters
    ----------
    T_a_b, T_b_c : (..., 3) arrays
        x [m], y [m], theta [rad]; leading axes broadcast.

    Returns
    -------
    (..., 3) array, theta in [-pi, pi).
    """
    if T_a_b.ndim == 1 and T_b_c.ndim == 1:
        T_a_c = np.empty(3)
        _compose(T_a_b, T_b_c, T_a_c)
        return T_a_c
    cos, sin = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = T_a_b[..., 0] + cos * T_b_c[..., 0] - sin * T_b_c[..., 1]
    y = T_a_b[..., 1] + sin * T_b_c[..., 0] + cos * T_b_c[..., 1]
    angle = wrap_angle(T_a_b[..., 2] + T_b_c[..., 2])
    return np.stack(np.broadcast_arrays(x, y, angle), axis=-1)


def inverse(T_a_b: FloatArray) -> FloatArray:
    """Invert transforms: ``T_b_a`` of ``T_a_b``, both (..., 3)."""
    if T_a_b.ndim == 1:
        x1, y1, t1 = T_a_b.tolist()
        c1, s1 = math.cos(t1), math.sin(t1)
        theta1 = (-t1 + math.pi) % (2.0 * math.pi) - math.pi
        return np.array([-c1 * x1 - s1 * y1, s1 * x1 - c1 * y1, theta1])
    c, s = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x = -c * T_a_b[..., 0] - s * T_a_b[..., 1]
    y = s * T_a_b[..., 0] - c * T_a_b[..., 1]
    return np.stack([x, y, wrap_angle(-T_a_b[..., 2])], axis=-1)


def between(T_a_b: FloatArray, T_a_c: FloatArray) -> FloatArray:
    """Relative transform ``T_b_c = inverse(T_a_b) * T_a_c``, all (..., 3)."""
    if T_a_b.ndim == 1 and T_a_c.ndim == 1:
        T_b_c = np.empty(3)
        _between(T_a_b, T_a_c, T_b_c)
        return T_b_c
    return compose(inverse(T_a_b), T_a_c)


def transform(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Transform points of frame b into frame a (the paper's RG on points, eq. 2 and 8).

    Parameters
    ----------
    T_a_b : (..., 3) array
    points_b : (..., n, 2) array [m]

    Returns
    -------
    (..., n, 2) array [m].
    """
    if T_a_b.ndim == 1 and points_b.ndim == 2:
        points_a = np.empty((points_b.shape[0], 2))
        transform_points(T_a_b, points_b, points_a)
        return points_a
    c, s = np.cos(T_a_b[..., 2])[..., None], np.sin(T_a_b[..., 2])[..., None]
    x = T_a_b[..., 0, None] + c * points_b[..., 0] - s * points_b[..., 1]
    y = T_a_b[..., 1, None] + s * points_b[..., 0] + c * points_b[..., 1]
    return np.stack([x, y], axis=-1)


def rotation(theta: npt.ArrayLike) -> FloatArray:
    """Rotation matrices (..., 2, 2) of angles (...) [rad]."""
    if isinstance(theta, float):  # numpy's scalars as well
        cos, sin = math.cos(theta), math.sin(theta)
        return np.array([[cos, -sin], [sin, cos]])
    theta = np.asarray(theta, dtype=np.float64)
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def exp(tangent: FloatArray) -> FloatArray:
    """Exponential map (..., 3) -> (..., 3), as ``gtsam.Pose2.Expmap``."""
    vx, vy, w = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    small = np.abs(w) < 1e-6
    safe = np.where(small, 1.0, w)
    a = np.where(small, 1.0 - w * w / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 * w, (1.0 - np.cos(safe)) / safe)
    return np.stack([a * vx - b * vy, b * vx + a * vy, wrap_angle(w)], axis=-1)


def log(T_a_b: FloatArray) -> FloatArray:
    """Logarithm map (..., 3) -> (..., 3), as ``gtsam.Pose2.Logmap``; theta within (-pi, pi)."""
    if T_a_b.ndim == 1:
        x1, y1, t1 = T_a_b.tolist()
        t1 = (t1 + math.pi) % (2.0 * math.pi) - math.pi
        h1 = 0.5 * t1
        a1 = 1.0 - h1 * h1 / 3.0 if abs(t1) < 1e-6 else h1 / math.tan(h1)
        return np.array([a1 * x1 + h1 * y1, -h1 * x1 + a1 * y1, t1])
    x, y, w = T_a_b[..., 0], T_a_b[..., 1], wrap_angle(T_a_b[..., 2])
    half = 0.5 * w
    small = np.abs(w) < 1e-6
    safe = np.where(small, 1.0, half)
    a = np.where(small, 1.0 - half * half / 3.0, safe / np.tan(safe))
    return np.stack([a * x + half * y, -half * x + a * y, w], axis=-1)


def distance(T_a_b: FloatArray, T_a_c: FloatArray) -> tuple[float, float]:
    """How far apart two poses (3,) are: metres and radians."""
    x, y, t = T_a_b.tolist()
    u, v, w = T_a_c.tolist()
    return math.hypot(u - x, v - y), abs((w - t + math.pi) % (2.0 * math.pi) - math.pi)


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """Adjoint matrices (..., 3, 3): ``T * exp(v) = exp(Ad_T v) * T``, order (x, y, theta)."""
    x, y, theta = T_a_b[..., 0], T_a_b[..., 1], T_a_b[..., 2]
    c, s = np.cos(theta), np.sin(theta)
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [np.stack([c, -s, y], -1), np.stack([s, c, -x], -1), np.stack([zero, zero, one], -1)]
    return np.stack(rows, axis=-2)


def compound_covariance(cov_a: FloatArray, T_a_b: FloatArray, cov_b: FloatArray) -> FloatArray:
    """Covariance of ``compose(T, T_a_b)`` to first order, for independent right perturbations.

    Parameters
    ----------
    cov_a : (..., 3, 3) covariance of T, body frame a
    T_a_b : (3,) the increment
    cov_b : (3, 3) covariance of the increment, body frame b

    Returns
    -------
    (..., 3, 3) covariance in body frame b: ``A cov_a A' + cov_b`` with ``A = Ad(inverse(T_a_b))``.
    """
    if cov_a.ndim == 2 and T_a_b.ndim == 1 and cov_b.ndim == 2:
        out = np.empty((3, 3))
        _compound_covariance(cov_a, T_a_b, cov_b, out)
        return out
    if T_a_b.ndim == 1 and cov_b.ndim == 2 and cov_a.ndim <= 3:
        out = np.empty(cov_a.shape)
        _compound_covariances(cov_a.reshape(-1, 3, 3), T_a_b, cov_b, out.reshape(-1, 3, 3))
        return out
    A = adjoint(inverse(T_a_b))
    return A @ cov_a @ np.swapaxes(A, -1, -2) + cov_b


@kernel
def _compose(T_a_b: FloatArray, T_b_c: FloatArray, out: FloatArray) -> None:
    c = math.cos(T_a_b[2])
    s = math.sin(T_a_b[2])
    out[0] = T_a_b[0] + c * T_b_c[0] - s * T_b_c[1]
    out[1] = T_a_b[1] + s * T_b_c[0] + c * T_b_c[1]
    out[2] = (T_a_b[2] + T_b_c[2] + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def _between(T_a_b: FloatArray, T_a_c: FloatArray, out: FloatArray) -> None:
    c = math.cos(T_a_b[2])
    s = math.sin(T_a_b[2])
    out[0] = -c * T_a_b[0] - s * T_a_b[1]  # the inverse of the first
    out[1] = s * T_a_b[0] - c * T_a_b[1]
    out[2] = (-T_a_b[2] + math.pi) % (2.0 * math.pi) - math.pi
    _compose(out, T_a_c, out)


@kernel
def transform_points(T_a_b: FloatArray, points_b: FloatArray, points_a: FloatArray) -> None:
    """Fill `points_a` with `points_b`, both (n, 2), transformed into frame a by one transform (3,)."""
    c = math.cos(T_a_b[2])
    s = math.sin(T_a_b[2])
    for k in range(points_b.shape[0]):
        points_a[k, 0] = T_a_b[0] + c * points_b[k, 0] - s * points_b[k, 1]
        points_a[k, 1] = T_a_b[1] + s * points_b[k, 0] + c * points_b[k, 1]


@kernel
def compound_three(
    cov_1: FloatArray,
    cov_2: FloatArray,
    cov_3: FloatArray,
    T_a_b: FloatArray,
    cov_b: FloatArray,
    covs_out: FloatArray,
) -> None:
    """Fill `covs_out` (3, 3, 3) with three covariances (3, 3), each compounded as `compound_covariance` does."""
    covs_a = np.empty((3, 3, 3))
    for i in range(3):
        for j in range(3):
            covs_a[0, i, j] = cov_1[i, j]
            covs_a[1, i, j] = cov_2[i, j]
            covs_a[2, i, j] = cov_3[i, j]
    _compound_covariances(covs_a, T_a_b, cov_b, covs_out)


@kernel
def _compound_covariance(
    cov_a: FloatArray, T_a_b: FloatArray, cov_b: FloatArray, cov_out: FloatArray
) -> None:
    _compound_covariances(cov_a.reshape(1, 3, 3), T_a_b, cov_b, cov_out.reshape(1, 3, 3))


@kernel
def _compound_covariances(
    covs_a: FloatArray, T_a_b: FloatArray, cov_b: FloatArray, covs_out: FloatArray
) -> None:
    # A = Ad(inverse(T_a_b)) = [[R', R' (-y, x)], [0, 1]]
    c = math.cos(T_a_b[2])
    s = math.sin(T_a_b[2])
    A = np.zeros((3, 3))
    A[0, 0] = c
    A[0, 1] = s
    A[0, 2] = s * T_a_b[0] - c * T_a_b[1]
    A[1, 0] = -s
    A[1, 1] = c
    A[1, 2] = c * T_a_b[0] + s * T_a_b[1]
    A[2, 2] = 1.0
    for k in range(covs_a.shape[0]):
        for i in range(3):
            for j in range(3):
                total = cov_b[i, j]
                for m in range(3):
                    for n in range(3):
                        total += A[i, m] * covs_a[k, m, n] * A[j, n]
                covs_out[k, i, j] = total


def body_to_world_covariance(cov_body: FloatArray, theta: npt.ArrayLike) -> FloatArray:
    """Turn a body-frame covariance (..., 3, 3) into that of (x, y, theta) in the parent frame.

    ``R3 C R3'`` with ``R3 = blkdiag(R(theta), 1)``; exact to first order, and not the adjoint.
    """
    theta = np.asarray(theta, dtype=np.float64)
    R3 = np.zeros((*theta.shape, 3, 3))
    R3[..., :2, :2] = rotation(theta)
    R3[..., 2, 2] = 1.0
    return R3 @ cov_body @ np.swapaxes(R3, -1, -2)
