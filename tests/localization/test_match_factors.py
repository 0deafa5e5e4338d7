from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.match_factors import match_factors
from slammot_graph.mapping.local_map import Keyframe
from tests.localization.matches import match_with

INFORMATION = np.diag([1e4, 1e4, 1e5])
T_ANCHOR_BASE = np.array([2.0, 0.1, 0.05])
KNOWN, UNKNOWN_WAY = np.diag([1e-6, 1e-6, 1e-8]), np.diag([0.04, 1e-6, 1e-8])
NOTHING = np.empty((0, 2))


def keyframe(node: int, x: float) -> Keyframe:
    return Keyframe(
        node=node,
        T_local_base=np.array([x, 0.0, 0.1]),
        points_base=NOTHING,
        normals_base=NOTHING,
        laser_base=np.zeros(2),
    )


KEYFRAMES = [keyframe(4, 1.0), keyframe(5, 1.5), keyframe(-1, 2.0), keyframe(6, 2.5)]


def scatter_of(told_x: list[float]) -> FloatArray:
    """Part of the normal matrix by keyframe: all tell of y and heading, each so much of x."""
    return np.array([np.diag([x, 100.0, 100.0]) for x in told_x], dtype=np.float64)


MATCH = match_with(
    T_ref_base=T_ANCHOR_BASE, graph_information=INFORMATION, map_scatter=scatter_of([1, 5, 90, 40])
)


def test_a_match_onto_a_map_that_is_well_known_is_the_anchors() -> None:
    for match in (replace(MATCH, cov_map=KNOWN), replace(MATCH, cov_map=UNKNOWN_WAY, map_scatter=None)):
        (factor,) = match_factors(match, KEYFRAMES)
        assert factor.node == 4
        assert factor.T_node_base is match.T_ref_base
        assert factor.information is match.graph_information


def test_what_the_anchor_cannot_be_told_the_keyframe_is_whose_points_tell_it() -> None:
    of_anchor, rest = match_factors(replace(MATCH, cov_map=UNKNOWN_WAY), KEYFRAMES)
    assert (of_anchor.node, rest.node) == (4, 6)  # that of most points is no node
    cov = np.linalg.inv(of_anchor.information)
    np.testing.assert_allclose(cov, np.linalg.inv(INFORMATION) + UNKNOWN_WAY, rtol=1e-6)
    np.testing.assert_allclose(of_anchor.information + rest.information, INFORMATION, atol=1e-6)
    T_local_base = se2.compose(KEYFRAMES[0].T_local_base, T_ANCHOR_BASE)
    np.testing.assert_allclose(se2.compose(KEYFRAMES[3].T_local_base, rest.T_node_base), T_local_base)


def test_where_the_anchors_own_points_tell_it_all_is_the_anchors() -> None:
    match = replace(MATCH, cov_map=UNKNOWN_WAY, map_scatter=scatter_of([90, 5, 9, 40]))
    (factor,) = match_factors(match, KEYFRAMES)
    assert factor.information is INFORMATION


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_directions_without_information_stay_so(angle: float) -> None:
    R = np.eye(3)
    R[:2, :2] = se2.rotation(angle)
    information, cov_map = R @ np.diag([0.0, 1e4, 1e5]) @ R.T, R @ np.diag([4.0, 1e-3, 1e-2]) @ R.T
    scatter = np.array([R @ part @ R.T for part in scatter_of([0, 0, 0, 0])]) * np.arange(4.0)[:, None, None]
    factors = match_factors(
        replace(MATCH, graph_information=information, cov_map=cov_map, map_scatter=scatter), KEYFRAMES
    )
    assert len(factors) == 2
    for factor in factors:
        np.testing.assert_allclose(R[:, 0] @ factor.information @ R[:, 0], 0.0, atol=1e-8)
