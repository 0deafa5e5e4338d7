import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.linalg import fused, invert, is_covariance, mahalanobis2


def positive_definite(seed: int, n: int = 3) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_inverse_inverts_and_is_symmetric(seed: int, n: int) -> None:
    matrix = positive_definite(seed, n)
    inverse = invert(matrix)
    np.testing.assert_allclose(inverse @ matrix, np.eye(n), atol=1e-8)
    np.testing.assert_array_equal(inverse, inverse.T)


def test_singular_matrix_has_no_inverse() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        invert(np.diag([1.0, 0.0, 2.0]))


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_information_taken_together_with_a_prior_adds_to_its_own(seed: int, n_directions: int) -> None:
    cov, root = positive_definite(seed), np.random.default_rng(seed + 1).normal(size=(3, n_directions))
    information = root @ root.T  # of the other directions nothing is known
    together = fused(cov, information)
    np.testing.assert_allclose(
        together, np.linalg.inv(np.linalg.inv(cov) + information), rtol=1e-8, atol=1e-8
    )
    np.testing.assert_array_equal(together, together.T)


@pytest.mark.parametrize(
    ("cov", "information"),
    [
        ([1.0, 0.0, 2.0], [1.0, 1.0, 1.0]),  # certain of a direction
        ([1.0, 0.5, 2.0], [0.0, -2.0, 0.0]),  # nothing is left of it
        ([1.0, np.nan, 2.0], [1.0, 1.0, 1.0]),
    ],
)
def test_what_has_no_covariance_is_not_taken_together(cov: list[float], information: list[float]) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        fused(np.diag(cov), np.diag(information))


@given(st.integers(0, 2**32 - 1))
def test_mahalanobis_is_the_length_after_whitening(seed: int) -> None:
    cov = positive_definite(seed)
    v = np.random.default_rng(seed + 1).normal(size=3)
    whitened = np.linalg.solve(np.linalg.cholesky(cov), v)
    assert mahalanobis2(v, cov) == pytest.approx(whitened @ whitened, rel=1e-8)


def test_covariances_are_told_from_other_matrices() -> None:
    good = positive_definite(1)
    assert is_covariance(good)
    assert is_covariance(1e-9 * np.eye(3))
    asymmetric, not_finite = good.copy(), good.copy()
    asymmetric[0, 1] += 0.1
    not_finite[1, 2] = not_finite[2, 1] = np.nan
    for bad in (
        asymmetric,
        not_finite,
        np.diag([1.0, -1e-3, 1.0]),
        np.zeros((3, 3)),
        np.inf * np.ones((3, 3)),
    ):
        assert not is_covariance(bad)
