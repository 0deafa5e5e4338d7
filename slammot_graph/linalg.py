"""The small matrix operations that covariances need, with their checks in one place."""

import math

import numpy as np

from slammot_graph._numba import kernel
from slammot_graph.types import FloatArray


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


@kernel
def invert3(a: FloatArray, out: FloatArray) -> bool:
    """Fill `out` with the inverse of the symmetric matrix `a`, both (3, 3); False where it is singular."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if determinant == 0.0 or not math.isfinite(determinant):
        return False
    out[0, 0] = c00 / determinant
    out[0, 1] = out[1, 0] = c01 / determinant
    out[0, 2] = out[2, 0] = c02 / determinant
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / determinant
    out[1, 2] = out[2, 1] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / determinant
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / determinant
    return True


def is_covariance(matrix: FloatArray) -> bool:
    """Tell whether an (n, n) matrix is finite, symmetric and positive definite."""
    if not np.isfinite(matrix).all() or np.abs(matrix - matrix.T).max() > 1e-6 * np.abs(matrix).max() + 1e-12:
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)


def mahalanobis2(offset: FloatArray, cov: FloatArray) -> float:
    """Squared Mahalanobis length of an (n,) offset under an (n, n) covariance."""
    return float(offset @ invert(cov) @ offset)
