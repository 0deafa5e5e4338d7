"""The small matrix operations that covariances need, with their checks in one place."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray


def invert(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive definite (n, n) matrix, symmetric again.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    if matrix.shape == (3, 3):
        inverse = np.empty((3, 3))
        if not invert3(np.ascontiguousarray(matrix, dtype=np.float64), inverse):
            raise np.linalg.LinAlgError("Singular matrix")
        return inverse
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return 0.5 * (inverse + inverse.T)


def covariance_of(information: FloatArray) -> FloatArray:
    """Covariance (3, 3) of an information matrix that may be singular: huge in directions without any."""
    return invert(information + _BARELY)


BARELY = 1e-6
"""Information that every direction has, so that a matrix of it can be inverted [1/m^2, 1/rad^2]."""

_BARELY: FloatArray = BARELY * np.eye(3)
_BARELY.setflags(write=False)


@kernel
def invert_lower(a: FloatArray, out: FloatArray) -> None:
    """Fill the lower triangle of `out` with the inverse of that of `a`, both (n, n); the upper ones do not matter."""
    n = a.shape[0]
    for j in range(n):
        out[j, j] = 1.0 / a[j, j]
        for i in range(j + 1, n):
            rest = 0.0
            for m in range(j, i):
                rest -= a[i, m] * out[m, j]
            out[i, j] = rest / a[i, i]


@kernel
def invert3(a: FloatArray, out: FloatArray) -> bool:
    """Fill `out` with the inverse of the symmetric matrix `a`, both (3, 3); False where that is not positive definite.

    By Cholesky's factor: cofactors lose all digits where one direction is known far worse than the others.
    """
    root = np.zeros((3, 3))
    back = np.zeros((3, 3))
    for j in range(3):
        for i in range(j, 3):
            rest = a[i, j]
            for m in range(j):
                rest -= root[i, m] * root[j, m]
            if i > j:
                root[i, j] = rest / root[j, j]
            elif rest > 0.0 and math.isfinite(rest):
                root[j, j] = math.sqrt(rest)
            else:
                return False
    invert_lower(root, back)
    for i in range(3):
        for j in range(i + 1):
            out[i, j] = back[i, i] * back[i, j]
            for m in range(i + 1, 3):
                out[i, j] += back[m, i] * back[m, j]
            out[j, i] = out[i, j]
    return True


def fused(cov: FloatArray, information: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a prior with covariance `cov` taken together with information: ``inv(inv(cov) + I)``.

    Raises
    ------
    numpy.linalg.LinAlgError
        A matrix is singular.
    """
    out = np.empty((3, 3))
    if not _fuse3(cov, information, out):
        raise np.linalg.LinAlgError("Singular matrix")
    return out


@kernel
def _fuse3(cov: FloatArray, information: FloatArray, out: FloatArray) -> bool:
    whole = np.empty((3, 3))
    if not invert3(cov, whole):
        return False
    for i in range(3):
        for j in range(3):
            whole[i, j] += information[i, j]
    return invert3(whole, out)


@kernel
def eigh3(a: FloatArray, values: FloatArray, vectors: FloatArray) -> None:
    """Fill `values` (3,), in no order, and `vectors`, in columns, of the symmetric matrix `a`, both (3, 3).

    Jacobi's method, which finds small eigenvalues of a scaled diagonal as well as large ones.
    """
    w = a.copy()
    vectors[:] = 0.0
    for i in range(3):
        vectors[i, i] = 1.0
    for _ in range(30):
        off = w[0, 1] * w[0, 1] + w[0, 2] * w[0, 2] + w[1, 2] * w[1, 2]
        if not off > 1e-32 * (w[0, 0] * w[0, 0] + w[1, 1] * w[1, 1] + w[2, 2] * w[2, 2]):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if w[p, q] == 0.0:
                    continue
                half = 0.5 * (w[q, q] - w[p, p]) / w[p, q]
                t = math.copysign(1.0, half) / (abs(half) + math.sqrt(half * half + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                r = 3 - p - q
                w[p, p] -= t * w[p, q]
                w[q, q] += t * w[p, q]
                w[p, q] = w[q, p] = 0.0
                low = w[p, r]
                high = w[q, r]
                w[p, r] = w[r, p] = c * low - s * high
                w[q, r] = w[r, q] = s * low + c * high
                for i in range(3):
                    low = vectors[i, p]
                    high = vectors[i, q]
                    vectors[i, p] = c * low - s * high
                    vectors[i, q] = s * low + c * high
    for i in range(3):
        values[i] = w[i, i]


@kernel
def sandwich3(a: FloatArray, m: FloatArray, out: FloatArray) -> None:
    """Fill `out` with ``a m a'``, all (3, 3); `out` is none of the others."""
    for i in range(3):
        am0 = a[i, 0] * m[0, 0] + a[i, 1] * m[1, 0] + a[i, 2] * m[2, 0]
        am1 = a[i, 0] * m[0, 1] + a[i, 1] * m[1, 1] + a[i, 2] * m[2, 1]
        am2 = a[i, 0] * m[0, 2] + a[i, 1] * m[1, 2] + a[i, 2] * m[2, 2]
        for j in range(3):
            out[i, j] = am0 * a[j, 0] + am1 * a[j, 1] + am2 * a[j, 2]


def is_covariance(matrix: FloatArray) -> bool:
    """Tell whether an (n, n) matrix is finite, symmetric and positive definite."""
    if not np.isfinite(matrix).all() or np.abs(matrix - matrix.T).max() > 1e-6 * np.abs(matrix).max() + 1e-12:
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)


def mahalanobis2(offset: FloatArray, cov: FloatArray) -> float:
    """Squared Mahalanobis length of an (n,) offset under an (n, n) covariance."""
    return float(offset @ invert(cov) @ offset)
