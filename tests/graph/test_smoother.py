"""The smoother's copy by `pickle`: the same, bit by bit, and it stays so."""

import pickle

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import SlammotError
from slammot_graph.graph.pose_graph import PoseGraph, PoseGraphConfig
from slammot_graph.graph.smoother import Smoother

CONFIG = PoseGraphConfig(relinearize_threshold=0.01)


def grow(graph: PoseGraph, rng: np.random.Generator, n: int) -> None:
    """Drive a circle with noise; a closure every ten nodes, some of them taken back; rebuilt once, merged once."""
    if len(graph) == 0:
        graph.start(np.zeros(3))
    step = np.array([0.6, 0.0, 0.2])
    for _ in range(n):
        last = len(graph) - 1
        T = se2.compose(step, rng.normal(size=3) * 0.03)
        node = graph.add_node(se2.compose(graph.pose(last), T))
        graph.add_edge("odometry", last, node, T, np.diag([400.0, 400.0, 900.0]))
        if node % 10 == 0:
            there = rng.integers(node - 5)
            T_there = se2.between(graph.pose(int(there)), graph.pose(node)) + rng.normal(size=3) * 0.05
            edge = graph.add_edge("closure", int(there), node, T_there, np.diag([100.0, 100.0, 300.0]))
            if node % 20 == 0:
                graph.update()
                graph.relative_covariance(node - 3, node)
                graph.remove_edges([edge])
        if node == 35:
            graph.rebuild(graph.poses())
        if node == 50:
            graph.add_edge("closure", 3, 46, se2.between(graph.pose(3), graph.pose(46)), np.eye(3))
            graph.add_edge("closure", 2, 40, se2.between(graph.pose(2), graph.pose(40)), np.eye(3))
            graph.merge(range(40, 46), onto=2, cut=46)


@pytest.mark.parametrize("n", [1, 9, 23, 45, 64])
def test_a_copy_is_the_same_and_goes_on_the_same(n: int) -> None:
    graph = PoseGraph(CONFIG)
    grow(graph, np.random.default_rng(1), n)
    copy = pickle.loads(pickle.dumps(graph))
    for one in (graph, copy):
        grow(one, np.random.default_rng(2), 25)
    np.testing.assert_array_equal(copy.poses(), graph.poses())
    np.testing.assert_array_equal(copy.marginals(), graph.marginals())
    assert graph.n_merged == (6 if n + 25 > 50 else 0)
    assert len(copy.edges) == len(graph.edges)
    for one in (graph, copy):
        one.close()


def test_what_waits_is_kept() -> None:
    graph = PoseGraph(CONFIG)
    graph.start(np.zeros(3))
    node = graph.add_node(np.ones(3))
    graph.add_edge("odometry", 0, node, np.ones(3), np.eye(3))
    copy = pickle.loads(pickle.dumps(graph))
    np.testing.assert_array_equal(copy.poses(), graph.poses())
    graph.close()
    copy.close()


def test_a_graph_that_cannot_be_solved_is_told() -> None:
    smoother = Smoother(CONFIG)
    with pytest.raises(SlammotError, match="cannot be solved"):
        smoother.add(None, [(0, np.zeros(3)), (1, np.ones(3))], [])
        smoother.marginal(1)
    assert np.isnan(smoother.known_poses(3)[2]).all()
    smoother.close()
