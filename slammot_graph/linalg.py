"""The small matrix operations that covariances need, with their checks in one place."""

import numpy as np

from slammot_graph.types import FloatArray


def invert(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive definite (n, n) matrix, symmetric again.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return 0.5 * (inverse + inverse.T)


def is_covariance(matrix: FloatArray) -> bool:
    """Tell whether an (n, n) matrix is finite, symmetric and positive definite."""
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12):
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)


def mahalanobis2(offset: FloatArray, cov: FloatArray) -> float:
    """Squared Mahalanobis length of an (n,) offset under an (n, n) covariance."""
    return float(offset @ np.linalg.solve(cov, offset))
