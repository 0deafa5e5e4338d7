import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.localization.base import FIRST_COV, fuse
from slammot_graph.localization.keyframe_state import KeyframeState
from tests.localization.matches import FAILED, match_with

seeds = st.integers(0, 2**32 - 1)
COV = np.diag([0.02, 0.01, 0.005]) ** 2


@given(seeds, st.integers(1, 6))
def test_what_is_known_is_carried_from_keyframe_to_keyframe(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    T_odom = rng.normal(0.0, [3.0, 3.0, 2.0], (n + 1, 3))
    state = KeyframeState()
    state.start(T_odom[0])
    state.start_node(T_odom[0], np.zeros(3), np.zeros(3))
    T_node_keyframe, cov_since_node, cov_keyframe = np.zeros(3), np.zeros((3, 3)), FIRST_COV
    for k in range(1, n + 1):
        match = (None, FAILED, match_with(graph_information=1e3 * np.eye(3)))[rng.integers(3)]
        step = state.advance(T_odom[k], COV, match)
        np.testing.assert_array_equal(step, se2.between(T_odom[k - 1], T_odom[k]))
        T_node_keyframe = se2.compose(T_node_keyframe, step)
        cov_since_node = se2.compound_covariance(cov_since_node, step, COV)
        cov_keyframe = se2.compound_covariance(cov_keyframe, step, COV)
        if match is not None and match is not FAILED:
            cov_keyframe = fuse(cov_keyframe, match)
        np.testing.assert_allclose(state.cov_since_node, cov_since_node, rtol=1e-9)
        np.testing.assert_allclose(state.cov_keyframe, cov_keyframe, rtol=1e-9)
    assert abs(se2.between(T_node_keyframe, state.since_node(T_odom[n]))).max() < 1e-9


@given(seeds)
def test_the_local_frame_lies_so_that_the_node_is_where_the_graph_has_it(seed: int) -> None:
    T_odom, T_local, T_map, T_moved, T_base = np.random.default_rng(seed).normal(0.0, [9.0, 9.0, 2.0], (5, 3))
    state = KeyframeState()
    state.cov_since_node = COV
    state.start_node(T_odom, T_local, T_map)
    assert not state.cov_since_node.any()
    assert abs(state.since_node(T_odom)).max() < 1e-9
    for T_map_node in (T_map, T_moved):
        state.place_node(T_map_node)
        apart = se2.between(T_map_node, se2.compose(state.T_map_local, T_local))
        assert abs(apart).max() < 1e-9
        # whatever lies on the node moves with it
        by_node = se2.compose(T_map_node, state.on_node(T_base))
        assert abs(se2.between(by_node, se2.compose(state.T_map_local, T_base))).max() < 1e-9
