"""Nodes merged into others: they lie where they lay, follow those, and the rest is solved without them."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.graph import PoseGraph
from tests.graph.test_pose_graph import batch, fill, graph, random_information

__all__ = ["graph"]


def test_merged_nodes_lie_where_they_lay(graph: PoseGraph, rng: np.random.Generator) -> None:
    fill(graph, rng)
    graph.add_edge("closure", 2, 20, se2.between(graph.pose(2), graph.pose(20)), random_information(rng))
    graph.add_edge("closure", 3, 24, se2.between(graph.pose(3), graph.pose(24)), random_information(rng))
    before, relative = graph.poses(), graph.relative_covariance(2, 22)
    graph.merge(range(20, 24), onto=2, cut=24)
    after = graph.poses()
    np.testing.assert_allclose(
        se2.between(after[2], after[20:24]), se2.between(before[2], before[20:24]), atol=1e-12
    )
    np.testing.assert_allclose(graph.pose(22), after[22], atol=1e-12)
    expected = se2.compound_covariance(graph.marginal(2), se2.between(after[2], after[22]), relative)
    np.testing.assert_allclose(graph.marginals()[22], expected, rtol=1e-6)
    solved = {node for edge in graph.edges for node in (edge.from_node, edge.to_node)}
    assert solved == set(range(20)) | {24}
    assert [(e.kind, e.from_node, e.to_node) for e in graph.all_edges[-4:]] == [
        ("closure", 2, 20),
        *(("match", 2, node) for node in (21, 22, 23)),
    ]
    _, values = batch(graph)
    for node in sorted(solved):
        pose = values.atPose2(node)
        np.testing.assert_allclose(graph.pose(node), [pose.x(), pose.y(), pose.theta()], atol=1e-4)


def test_merged_nodes_follow(graph: PoseGraph, rng: np.random.Generator) -> None:
    fill(graph, rng)
    graph.add_edge("closure", 2, 20, se2.between(graph.pose(2), graph.pose(20)), random_information(rng))
    graph.add_edge("closure", 3, 24, se2.between(graph.pose(3), graph.pose(24)), random_information(rng))
    graph.merge(range(20, 24), onto=2, cut=24)
    before = graph.poses()
    # what is told of a merged node is told of that which it lies on
    moved = se2.compose(se2.between(before[10], before[22]), np.array([0.3, -0.2, 0.05]))
    graph.add_edge("closure", 10, 22, moved, 1e6 * np.eye(3))
    graph.add_edge("closure", 22, 11, se2.between(before[22], before[11]), 1e-3 * np.eye(3))
    assert graph.try_edge("closure", 2, 22, moved, np.eye(3)) is None
    after = graph.poses()
    np.testing.assert_allclose(se2.between(after[10], after[22]), moved, atol=0.02)
    np.testing.assert_allclose(
        se2.between(after[2], after[22]), se2.between(before[2], before[22]), atol=1e-12
    )
    assert np.hypot(*(after[2] - before[2])[:2]) > 0.01
    graph.rebuild(after)
    np.testing.assert_allclose(graph.poses(), after, atol=5e-3)
    np.testing.assert_allclose(graph.snapshot().poses(), graph.poses(), atol=1e-9)
