from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.linalg import is_covariance
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.base import FIRST_COV
from slammot_graph.localization.graph_insertion import GraphInsertion
from slammot_graph.loop_closure import Submap, SubmapConfig
from slammot_graph.mapping.local_map import NO_NODE, LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.odometry import MotionState
from tests.localization.matches import match_with
from tests.rooms import LASER, take_scan

A = np.array([2.0, 0.0, 1.5])
STEP = np.array([0.3, 0.0, 0.05])
COV = np.diag([0.01, 0.01, 0.004]) ** 2
MAX_KEYFRAMES, N_OVERLAP = 6, 3
LOCAL_MAP = LocalMapConfig(max_keyframes=MAX_KEYFRAMES, n_overlap=N_OVERLAP)


class Closer:
    """In place of the loop closing: keeps what it is told."""

    def __init__(self, is_known: bool = False) -> None:
        self.is_known = is_known
        self.submaps: list[Submap] = []
        self.known: list[Submap] = []
        self.n_searches = 0

    def is_sought(self, component: int) -> bool:
        return False

    def look_all_over(self) -> None:
        self.n_searches += 1

    def consider(self, submap: Submap) -> tuple[()]:
        self.submaps.append(submap)
        return ()


@pytest.fixture
def insertion() -> Iterator[GraphInsertion]:
    config = ScanToMapConfig(close_loops=False, local_map=LOCAL_MAP)
    insertion = GraphInsertion(config, LocalMap(config.local_map))
    yield insertion
    insertion.graph.close()


def pose(k: int) -> FloatArray:
    T = np.zeros(3)
    for _ in range(k):
        T = se2.compose(T, STEP)
    return T


def insert(insertion: GraphInsertion, k: int, path_m: float = 0.0) -> tuple[int | None, MotionState]:
    """The k-th keyframe of a drive that odometry and matches agree on."""
    state = MotionState(
        T_local_base=pose(k),
        cov_prior=COV,
        cov_independent=COV,
        cov_correlated=0.1 * COV,
        cov_odometry=COV,
        cov_motion=0.1 * COV,
    )
    match = None
    if insertion.local_map.keyframes:
        information = np.linalg.inv(COV)
        match = match_with(
            T_ref_base=insertion.anchor(pose(k))[1], information=information, graph_information=information
        )
    insertion.advance(state, pose(k), match)
    node = insertion.add_node(10 * k, pose(k), pose(k), match) if insertion.needs_node() else None
    scan = take_scan(se2.compose(A, pose(k)))
    keyframe = make_keyframe(
        NO_NODE if node is None else node, pose(k), scan.points_base(), scan.is_valid(), LASER, LOCAL_MAP
    )
    after, closures = insertion.add_keyframe(keyframe, node, state, path_m)
    assert closures == ()
    return node, after


def test_keyframes_become_nodes_tied_by_odometry_and_matches(insertion: GraphInsertion) -> None:
    assert [insert(insertion, k)[0] for k in range(8)] == list(range(8))
    kinds = [(edge.kind, edge.from_node, edge.to_node) for edge in insertion.graph.edges]
    anchors = [0, 0, 0, 0, 0, 3, 3]  # the first local map is replaced by that of node 3
    assert kinds == [
        edge for k in range(1, 8) for edge in (("odometry", k - 1, k), ("match", anchors[k - 1], k))
    ]
    np.testing.assert_allclose(insertion.graph.poses(), [pose(k) for k in range(8)], atol=1e-6)
    assert insertion.node_scans == [10 * k for k in range(8)]
    anchor, T_anchor_base = insertion.anchor(pose(9))
    assert anchor == 3
    np.testing.assert_allclose(T_anchor_base, se2.between(pose(3), pose(9)), atol=1e-12)


def test_the_state_is_relative_to_the_anchor(insertion: GraphInsertion) -> None:
    for k in range(8):
        _, state = insert(insertion, k)
        np.testing.assert_array_equal(state.cov_prior, insertion.keyframes.cov_keyframe)
        if k == 0:
            np.testing.assert_array_equal(state.cov_independent, FIRST_COV)
            assert not state.cov_correlated.any()
        elif k != MAX_KEYFRAMES - 1:
            np.testing.assert_array_equal(state.cov_independent, COV)
        else:  # another anchor
            assert is_covariance(state.cov_independent)
            assert not np.allclose(state.cov_independent, COV, rtol=1e-3)
            cov = insertion.graph.relative_covariance(N_OVERLAP, k)
            np.testing.assert_allclose(state.cov_prior, cov, rtol=1e-6)


def test_a_finished_local_map_goes_to_the_loop_closing(insertion: GraphInsertion) -> None:
    closer: Any = Closer()
    insertion.closer = closer
    for k in range(9):
        insert(insertion, k, path_m=0.3 * k)
    assert [(submap.number, submap.anchor, submap.component) for submap in closer.submaps] == [
        (0, 0, 0),
        (1, 3, 0),
    ]
    assert [submap.path_m for submap in closer.submaps] == pytest.approx([1.5, 2.4])
    assert all(len(submap.keyframes) == MAX_KEYFRAMES for submap in closer.submaps)
    assert closer.submaps[0].config == SubmapConfig()


def test_in_a_known_place_only_ends_of_local_maps_are_nodes(insertion: GraphInsertion) -> None:
    closer: Any = Closer(is_known=True)
    insertion.closer = closer
    nodes = [insert(insertion, k)[0] for k in range(9)]
    # the first, the one at which the next local map begins, and the one that finishes it
    assert [k for k, node in enumerate(nodes) if node is not None] == [0, 3, 5, 6, 8]
    anchors = [keyframe.node for keyframe in insertion.local_map.keyframes[:1]]
    assert anchors == [nodes[6]]
    # the odometry from node to node is that of all keyframes between
    odometry = [edge for edge in insertion.graph.edges if edge.kind == "odometry"]
    np.testing.assert_allclose(odometry[0].T_from_to, se2.between(pose(0), pose(3)), atol=1e-12)
    assert np.trace(odometry[0].information) < np.trace(np.linalg.inv(COV))


def test_a_lost_robot_begins_a_new_component(insertion: GraphInsertion) -> None:
    closer: Any = Closer()
    insertion.closer = closer
    for k in range(3):
        insert(insertion, k)
    insertion.start_component(path_m=77.0)
    assert insertion.local_map.keyframes == []
    assert insertion.n_times_lost == 1
    assert closer.n_searches == 1
    (submap,) = closer.submaps
    assert (submap.path_m, submap.component, len(submap.keyframes)) == (77.0, 0, 3)
    np.testing.assert_allclose(insertion.cov_anchor, insertion.graph.marginal(2), rtol=1e-9)
    # until there is a local map again, the last node is the anchor
    anchor, T_anchor_base = insertion.anchor(pose(3))
    assert anchor == 2
    np.testing.assert_allclose(T_anchor_base, STEP, atol=1e-12)
    for k in range(3, 9):
        insert(insertion, k)
    assert [submap.component for submap in closer.submaps] == [0, 1]
    kinds = [(edge.kind, edge.from_node, edge.to_node) for edge in insertion.graph.edges]
    assert ("odometry", 2, 3) in kinds
    assert not any(kind == "match" and a < 3 <= b for kind, a, b in kinds)


def test_nothing_is_known_of_an_empty_graph(insertion: GraphInsertion) -> None:
    assert insertion.needs_node()
    insertion.closer = SimpleNamespace(is_known=True)  # type: ignore[assignment]
    assert insertion.needs_node()
    assert insertion.anchor(STEP)[0] == 0
