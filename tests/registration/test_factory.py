import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.registration.base import MatchPrior, ReferenceScan
from slammot_graph.registration.factory import make_matcher
from slammot_graph.registration.point_to_line import (
    PointToLineConfig,
    PointToLineMatcher,
    match_to_local_map,
)
from slammot_graph.registration.point_to_point import PointToPointConfig, PointToPointMatcher, match_scans
from tests.rooms import LASER, take_scan

A, B = np.array([0.5, 0.3, 0.2]), np.array([0.53, 0.31, 0.22])
COV: FloatArray = 1e-3 * np.eye(3)


def test_the_factory_builds_what_the_configuration_names() -> None:
    assert isinstance(make_matcher(PointToLineConfig()), PointToLineMatcher)
    assert isinstance(make_matcher(PointToPointConfig()), PointToPointMatcher)


def test_a_matcher_onto_a_local_map_is_the_function_with_its_kernel_made_narrower() -> None:
    first, second = take_scan(A), take_scan(B)
    local_map = LocalMap(LocalMapConfig())
    local_map.add(make_keyframe(0, A, first.points_base(), first.is_valid(), LASER, local_map.config))
    matcher = make_matcher(PointToLineConfig(kernel_scale_m=0.1))
    points, is_valid, laser = second.points_base(), second.is_valid(), LASER.origin_base
    prior = MatchPrior(T_a_base=A, cov=COV, cov_independent=2.0 * COV)
    for factor in (1.0, 0.5):
        config = PointToLineConfig(kernel_scale_m=0.1 * factor)
        found = matcher.match(local_map, points, is_valid, laser, prior, kernel_factor=factor)
        result, T, cov = match_to_local_map(points, is_valid, laser, local_map, A, COV, config, 2.0 * COV)
        np.testing.assert_array_equal(found.result.T_ref_base, result.T_ref_base)
        np.testing.assert_array_equal(found.T_a_base, T)
        np.testing.assert_array_equal(found.cov, cov)
    np.testing.assert_allclose(found.T_a_base, B, atol=0.01)


def test_a_matcher_onto_a_scan_is_the_function_and_gives_the_prior_back_where_it_fails() -> None:
    first, second = take_scan(A), take_scan(B)
    matcher = make_matcher(PointToPointConfig())
    reference = ReferenceScan(points_base=first.points_base(), is_used=first.is_valid())
    prior = MatchPrior(T_a_base=np.array([0.02, 0.0, 0.01]), cov=COV)
    points, is_valid, laser = second.points_base(), second.is_valid(), LASER.origin_base
    found = matcher.match(reference, points, is_valid, laser, prior)
    result = match_scans(
        first.points_base(), first.is_valid(), points, is_valid, prior.T_a_base, PointToPointConfig()
    )
    np.testing.assert_array_equal(found.T_a_base, result.T_ref_base)
    np.testing.assert_array_equal(found.cov, result.cov)
    failed = matcher.match(reference, points, np.zeros_like(is_valid), laser, prior)
    assert failed.result.status == "failed"
    assert failed.T_a_base is prior.T_a_base
    assert failed.cov is prior.cov
