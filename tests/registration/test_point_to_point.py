import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.linalg import is_covariance
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import FloatArray
from slammot_graph.registration.point_to_point import PointToPointConfig, match_scans
from tests.rooms import take_scan

ALL = np.ones(60, dtype=bool)


def cloud(rng: np.random.Generator) -> FloatArray:
    return rng.uniform(-5.0, 5.0, (60, 2))


def test_a_known_transform_is_recovered_with_its_covariance(rng: np.random.Generator) -> None:
    reference, T = cloud(rng), np.array([0.04, -0.02, 0.01])
    points = se2.transform(se2.inverse(T), reference)
    result = match_scans(reference, ALL, points, ALL, np.zeros(3), PointToPointConfig(pair_std_m=0.02))
    assert result.status == "converged"
    np.testing.assert_allclose(result.T_ref_base, T, atol=1e-9)
    assert (result.n_correspondences, result.inlier_ratio) == (60, 1.0)
    assert result.residual_m == pytest.approx(0.0, abs=1e-9)
    # each pair tells x and y of its point: rows [I | (-py, px)']
    J = np.array([[[1.0, 0.0, -p[1]], [0.0, 1.0, p[0]]] for p in points]).reshape(-1, 3)
    np.testing.assert_allclose(result.information, J.T @ J / 0.02**2, rtol=1e-9)
    np.testing.assert_allclose(result.cov, np.linalg.inv(J.T @ J) * 0.02**2, rtol=1e-6)


def test_covariance_holds_by_monte_carlo(rng: np.random.Generator) -> None:
    reference, found = 4.0 * cloud(rng), []  # far apart: the pairs are the true ones
    for _ in range(400):
        points = reference + rng.normal(0, 0.02, (60, 2))
        result = match_scans(reference, ALL, points, ALL, np.zeros(3), PointToPointConfig(pair_std_m=0.02))
        found.append(se2.log(result.T_ref_base))
    ratio = np.var(found, axis=0) / np.diag(result.cov)
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)


def test_masked_points_do_not_count(rng: np.random.Generator) -> None:
    reference, T = cloud(rng), np.array([0.03, 0.02, -0.01])
    points = se2.transform(se2.inverse(T), reference)
    points[:20] += 0.3
    reference[20:25] = np.nan
    is_reference, is_used = np.isfinite(reference[:, 0]), np.arange(60) >= 20
    config = PointToPointConfig(max_distance_m=0.2)
    result = match_scans(reference, is_reference, points, is_used, np.zeros(3), config)
    np.testing.assert_allclose(result.T_ref_base, T, atol=1e-9)
    assert result.n_correspondences == 35
    assert result.inlier_ratio == pytest.approx(35 / 40)


def failed(result: MatchResult, start: FloatArray) -> bool:
    same = np.array_equal(result.T_ref_base, start) and not result.information.any()
    return result.status == "failed" and same and is_covariance(result.cov)


def test_no_partners_fail_with_the_start(rng: np.random.Generator) -> None:
    start = np.array([100.0, 0.0, 0.1])
    result = match_scans(cloud(rng), ALL, cloud(rng), ALL, start, PointToPointConfig())
    assert failed(result, start)
    assert result.reason == "only 0 points found a partner within 0.5 m"


def test_empty_scans_fail_with_the_start(rng: np.random.Generator) -> None:
    start, none = np.array([0.1, 0.0, 0.1]), np.zeros(60, dtype=bool)
    for is_reference, is_used in ((none, ALL), (ALL, none), (none, none)):
        result = match_scans(cloud(rng), is_reference, cloud(rng), is_used, start, PointToPointConfig())
        assert failed(result, start)


def test_scans_of_a_room_match_well_enough() -> None:
    A, moved = np.array([2.0, 0.0, 1.5]), np.array([0.02, 0.01, 0.01])
    first, second = take_scan(A), take_scan(se2.compose(A, moved))
    result = match_scans(
        first.points_base(),
        first.is_valid(),
        second.points_base(),
        second.is_valid(),
        np.zeros(3),
        PointToPointConfig(),
    )
    # nearest points slide along the walls: the paper's match is no better than this
    np.testing.assert_allclose(result.T_ref_base, moved, atol=0.03)


@pytest.mark.parametrize("name", ["tau_m", "max_distance_m", "pair_std_m"])
def test_impossible_matches_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"PointToPointConfig.{name} must be positive, not 0.0"):
        PointToPointConfig(**{name: 0.0})  # type: ignore[arg-type]


def test_a_match_needs_an_iteration() -> None:
    with pytest.raises(ConfigError, match=r"PointToPointConfig\.max_iterations must be at least 1, not 0"):
        PointToPointConfig(max_iterations=0)
