import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.linalg import mahalanobis2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.registration.point_to_line import PointToLineConfig, match_to_local_map
from tests.rooms import CORRIDOR, LASER, ROOM, take_scan

A = np.array([2.0, 0.0, 1.7])
MOVED = np.array([0.12, -0.06, 0.05])
LOOSE = np.diag([0.3, 0.3, 0.2]) ** 2
SHIFT = np.array([20.0, -30.0, 2.5])
ORIGIN = np.zeros(3)


def map_from(
    T_world_base: FloatArray, T_local_base: FloatArray, walls: FloatArray = ROOM, max_range: float = np.inf
) -> LocalMap:
    """A local map of five scans around a place; the first is the anchor."""
    local_map, config = LocalMap(LocalMapConfig()), LocalMapConfig()
    for k in range(5):
        step = np.array([0.0, 0.0, 0.005 * k])
        scan, T = take_scan(se2.compose(T_world_base, step), walls=walls), se2.compose(T_local_base, step)
        local_map.add(make_keyframe(k, T, scan.points_base(), scan.is_valid(max_range), LASER, config))
    return local_map


def match(
    scan: Scan,
    local_map: LocalMap,
    start: FloatArray,
    cov: FloatArray = LOOSE,
    max_range: float = np.inf,
    **config: float,
) -> tuple[MatchResult, FloatArray]:
    return match_to_local_map(
        scan.points_base(),
        scan.is_valid(max_range),
        LASER.origin_base,
        local_map,
        start,
        cov,
        PointToLineConfig(**config),  # type: ignore[arg-type]
    )[:2]


@pytest.mark.parametrize(
    ("place", "T_local", "moved"),
    [(A, ORIGIN, MOVED), (se2.compose(A, MOVED), ORIGIN, se2.inverse(MOVED)), (A, SHIFT, MOVED)],
    ids=["forward", "inverse", "shifted"],
)
def test_a_known_transform_is_recovered(place: FloatArray, T_local: FloatArray, moved: FloatArray) -> None:
    local_map = map_from(place, T_local)
    result, T_local_base = match(take_scan(se2.compose(place, moved)), local_map, T_local)
    assert result.status == "converged"
    assert result.reason == ""
    np.testing.assert_allclose(result.T_ref_base, moved, atol=2e-3)
    np.testing.assert_allclose(se2.between(T_local, T_local_base), moved, atol=2e-3)
    assert result.inlier_ratio > 0.9
    assert result.residual_m < 0.01


def test_outliers_do_not_pull(rng: np.random.Generator) -> None:
    scan = take_scan(se2.compose(A, MOVED), noise=rng.normal(0, 0.01, LASER.n_beams))
    bad = rng.random(LASER.n_beams) < 0.3
    scan.ranges[bad] *= rng.uniform(0.3, 0.95, bad.sum())
    result, T = match(scan, map_from(A, ORIGIN), ORIGIN)
    assert result.status == "converged"
    np.testing.assert_allclose(T, MOVED, atol=6e-3)
    assert 0.5 < result.inlier_ratio < 0.9


def test_errors_fit_the_covariance(rng: np.random.Generator) -> None:
    local_map, nees = map_from(A, ORIGIN), []
    for _ in range(30):
        moved = rng.normal(0, [0.1, 0.1, 0.05])
        scan = take_scan(se2.compose(A, moved), noise=rng.normal(0, 0.03, LASER.n_beams))
        result, _ = match(scan, local_map, se2.compose(moved, rng.normal(0, 0.02, 3)))
        nees.append(mahalanobis2(se2.log(se2.between(moved, result.T_ref_base)), result.cov))
    # 3 if consistent; within a factor of three on noise of the configured size
    assert 1.0 < np.mean(nees) < 9.0


def test_covariance_inverts_information_and_is_symmetric() -> None:
    result, _ = match(take_scan(A), map_from(A, ORIGIN), ORIGIN)
    np.testing.assert_allclose(result.cov @ result.information, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(result.information, result.information.T, rtol=1e-12)
    config = PointToLineConfig()
    assert (
        np.sqrt(np.diag(result.cov))
        > [config.correlated_std_m, config.correlated_std_m, config.correlated_std_rad]
    ).all()
    assert np.linalg.eigvalsh(result.cov - result.cov_correlated)[0] > 0.0
    graph_cov = np.linalg.inv(result.graph_information)
    assert (np.sqrt(np.diag(graph_cov))[:2] > config.floor_std_m).all()


def test_a_far_start_is_found_by_searching_around_it() -> None:
    start = np.array([0.5, 0.5, 0.0])
    scan, local_map = take_scan(A), map_from(A, ORIGIN)
    without, _ = match(scan, local_map, start, search_m=0.0, search_rad=0.0)
    assert without.status == "failed"
    found, T = match(scan, local_map, start)
    assert found.status == "converged"
    np.testing.assert_allclose(T, ORIGIN, atol=2e-3)


def test_a_tight_prior_outweighs_the_match() -> None:
    _, T = match(take_scan(se2.compose(A, MOVED)), map_from(A, ORIGIN), ORIGIN, cov=1e-10 * np.eye(3))
    np.testing.assert_allclose(T, ORIGIN, atol=1e-3)


def test_the_match_itself_is_free_of_the_prior() -> None:
    local_map, start = map_from(A, ORIGIN), np.array([0.01, -0.01, 0.005])
    loose, _ = match(take_scan(A), local_map, start)
    result, T = match(take_scan(A), local_map, start, cov=np.diag([0.01, 0.01, 0.005]) ** 2)
    np.testing.assert_allclose(result.T_ref_base, loose.T_ref_base, atol=1e-4)
    assert np.abs(T - loose.T_ref_base).max() > 1e-3


def test_a_corridor_is_degenerate_along_itself() -> None:
    place = np.array([0.0, 0.1, 0.4])
    # no farther than points are near enough to each other to have normals
    scan, local_map = take_scan(place, walls=CORRIDOR), map_from(place, ORIGIN, CORRIDOR, max_range=5.0)
    along = se2.rotation(-place[2]) @ [1.0, 0.0]  # in the base frame
    across = se2.rotation(-place[2]) @ [0.0, 1.0]
    start = np.array([*(0.15 * along + 0.05 * across), 0.03])
    result, T = match(scan, local_map, start, max_range=5.0)
    assert result.status == "degenerate"
    assert result.reason == "1 of 3 directions are not determined"
    v = np.array([*along, 0.0])
    assert v @ result.information @ v < 1e-6 * np.trace(result.information)
    assert v @ result.cov @ v > 1e3
    # along it the prediction, across it and in rotation the walls
    assert T[:2] @ along == pytest.approx(0.15, abs=5e-3)
    assert T[:2] @ across == pytest.approx(0.0, abs=3e-3)
    assert T[2] == pytest.approx(0.0, abs=3e-3)
    np.testing.assert_allclose(result.T_ref_base, T, atol=3e-3)


def test_directions_below_the_weak_ratio_carry_no_information() -> None:
    result, _ = match(take_scan(A), map_from(A, ORIGIN), ORIGIN, weak_ratio=0.29)
    n_weak = int(result.reason[0])
    assert 1 <= n_weak <= 2
    values = np.linalg.eigvalsh(result.information)
    assert (np.abs(values) < 1e-9 * values[-1]).tolist() == [k < n_weak for k in range(3)]


def assert_failed(result: MatchResult, T: FloatArray, predicted: FloatArray, reason: str) -> None:
    assert result.status == "failed"
    assert reason in result.reason
    np.testing.assert_array_equal(T, predicted)
    np.testing.assert_array_equal(result.information, np.zeros((3, 3)))
    assert (np.diag(result.cov) > 1e3).all()


def test_an_empty_scan_fails_and_keeps_the_prediction() -> None:
    scan, predicted = take_scan(A), np.array([0.3, 0.2, 0.1])
    scan.ranges[:] = np.inf
    result, T = match(scan, map_from(A, ORIGIN), predicted)
    assert_failed(result, T, predicted, "only 0 points found a partner")
    np.testing.assert_allclose(result.T_ref_base, predicted, atol=1e-12)


def test_no_overlap_fails_and_keeps_the_prediction() -> None:
    predicted = np.array([45.0, 0.0, 0.1])
    result, T = match(take_scan(A), map_from(A, ORIGIN), predicted)
    assert_failed(result, T, predicted, "only 0 points found a partner")


def test_points_that_disagree_fail(rng: np.random.Generator) -> None:
    scan = take_scan(A)
    scan.ranges[:] = rng.uniform(0.5, 5.0, LASER.n_beams)
    result, T = match(scan, map_from(A, ORIGIN), ORIGIN, min_inlier_ratio=0.9)
    assert_failed(result, T, ORIGIN, "of the points agree with the local map")


def test_a_match_that_determines_nothing_fails(rng: np.random.Generator) -> None:
    scan = take_scan(A)
    bad = rng.random(LASER.n_beams) < 0.75
    scan.ranges[bad] += rng.uniform(0.1, 0.35, bad.sum())  # near enough to pair, too far to weigh much
    result, T = match(scan, map_from(A, ORIGIN), ORIGIN, weak_ratio=0.29)
    assert result.n_correspondences > 100
    assert_failed(result, T, ORIGIN, "no direction is determined")
    np.testing.assert_array_equal(result.innovation, np.zeros(3))


def test_a_wall_seen_from_its_other_side_is_no_partner() -> None:
    scan, local_map = take_scan(A), map_from(A, ORIGIN)
    points, used, config = scan.points_base(), scan.is_valid(), PointToLineConfig()
    inside, anywhere, outside = (
        match_to_local_map(points, used, np.array(laser), local_map, ORIGIN, LOOSE, config)[0]
        for laser in ([0.1, 0.0], [np.nan, np.nan], [0.0, 50.0])
    )
    assert inside.n_correspondences == anywhere.n_correspondences == LASER.n_beams
    np.testing.assert_array_equal(inside.T_ref_base, anywhere.T_ref_base)
    assert outside.n_correspondences < 0.8 * LASER.n_beams


def test_the_innovation_leads_from_the_prediction_to_the_match() -> None:
    predicted = np.array([0.05, 0.02, -0.03])
    result, _ = match(take_scan(se2.compose(A, MOVED)), map_from(A, ORIGIN), predicted)
    found = se2.compose(predicted, se2.exp(result.innovation))
    np.testing.assert_allclose(found, result.T_ref_base, atol=1e-12)
    assert np.abs(result.innovation).min() > 0.05


def test_too_few_points_fail() -> None:
    scan = take_scan(A)
    scan.ranges[14:] = np.nan
    result, T = match(scan, map_from(A, ORIGIN), ORIGIN)
    assert_failed(result, T, ORIGIN, "only 14 points found a partner")


@pytest.mark.parametrize("name", ["residual_std_m", "kernel_scale_m", "min_step_m", "min_step_rad"])
@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_impossible_noise_is_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"PointToLineConfig.{name} must be positive, not {value}"):
        PointToLineConfig(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["floor_std_m", "weak_ratio", "search_m", "search_rad"])
def test_negative_limits_are_refused(name: str) -> None:
    PointToLineConfig(**{name: 0.0})  # type: ignore[arg-type]
    with pytest.raises(
        ConfigError, match=f"PointToLineConfig.{name} must (not be negative|be in .*), not -0.1"
    ):
        PointToLineConfig(**{name: -0.1})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"max_iterations": 0}, "PointToLineConfig.max_iterations must be at least 1, not 0"),
        ({"min_pairs": 2}, "PointToLineConfig.min_pairs must be at least 3, not 2"),
        ({"min_inlier_ratio": 1.0}, r"PointToLineConfig.min_inlier_ratio must be in \[0, 1\), not 1.0"),
        ({"weak_ratio": 0.3}, r"PointToLineConfig.weak_ratio must be in \[0, 0.3\), not 0.3"),
        ({"min_inlier_ratio": -0.1}, r"PointToLineConfig.min_inlier_ratio must be in \[0, 1\), not -0.1"),
    ],
)
def test_impossible_stops_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        PointToLineConfig(**changes)  # type: ignore[arg-type]
