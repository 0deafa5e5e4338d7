import threading
from collections.abc import Iterator
from typing import Any

import gtsam
import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError, SlammotError
from slammot_graph.core.linalg import is_covariance
from slammot_graph.core.results import EdgeKind, GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from tests.rooms import errors

PRIOR_STD = 1e-3


@pytest.fixture
def graph() -> Iterator[PoseGraph]:
    graph = PoseGraph(
        PoseGraphConfig(prior_std_m=PRIOR_STD, prior_std_rad=PRIOR_STD, relinearize_threshold=1e-4)
    )
    yield graph
    graph.close()


def random_information(rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(3, 3))
    information: FloatArray = np.linalg.inv(
        np.diag([0.05, 0.04, 0.02]) @ (root @ root.T + np.eye(3)) @ np.diag([0.05, 0.04, 0.02])
    ).astype(np.float64)
    return information


def fill(graph: PoseGraph, rng: np.random.Generator, n: int = 25) -> None:
    """A loop of n nodes with noisy edges and some closures, optimised until nothing moves."""
    truth = np.array([[4 * np.cos(a), 4 * np.sin(a), a + np.pi / 2] for a in np.linspace(0.0, 6.5, n)])
    graph.start(truth[0])
    for k in range(1, n):
        information = random_information(rng)
        noise = rng.multivariate_normal(np.zeros(3), np.linalg.inv(information))
        step = se2.compose(se2.between(truth[k - 1], truth[k]), se2.exp(noise))
        graph.add_node(se2.compose(graph.pose(k - 1), step))
        graph.add_edge("odometry", k - 1, k, step, information)
        if k % 6 == 5:
            back = se2.compose(se2.between(truth[k], truth[k - 5]), rng.normal(0, 0.03, 3))
            graph.add_edge("closure", k, k - 5, back, random_information(rng))
        graph.update()
    for _ in range(5):
        graph.update()


def pose2(T: FloatArray) -> gtsam.Pose2:
    return gtsam.Pose2(*T.tolist())


def batch(graph: PoseGraph) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The same graph at once by Levenberg-Marquardt, from its edges alone."""
    factors, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = graph.pose(0)
    factors.add(gtsam.PriorFactorPose2(0, pose2(first), gtsam.noiseModel.Isotropic.Sigma(3, PRIOR_STD)))
    initial.insert(0, pose2(first))
    for edge in graph.edges:
        noise = gtsam.noiseModel.Gaussian.Information(edge.information)
        factors.add(gtsam.BetweenFactorPose2(edge.from_node, edge.to_node, pose2(edge.T_from_to), noise))
        if not initial.exists(edge.to_node):
            initial.insert(edge.to_node, initial.atPose2(edge.from_node).compose(pose2(edge.T_from_to)))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    return factors, gtsam.LevenbergMarquardtOptimizer(factors, initial, parameters).optimize()


def test_poses_and_covariances_equal_those_of_a_batch(graph: PoseGraph, rng: np.random.Generator) -> None:
    fill(graph, rng)
    factors, values = batch(graph)
    assert errors(graph.poses(), gtsam.utilities.extractPose2(values)) == pytest.approx((0.0, 0.0), abs=1e-4)
    marginals = gtsam.Marginals(factors, values)
    expected = np.array([marginals.marginalCovariance(k) for k in range(len(graph))])
    np.testing.assert_allclose(graph.marginals(), expected, rtol=0.01, atol=1e-8)
    for k in (0, 7, 24):
        np.testing.assert_allclose(graph.pose(k), graph.poses()[k], atol=1e-9)
        np.testing.assert_allclose(graph.marginal(k), expected[k], rtol=0.01, atol=1e-8)


@pytest.mark.parametrize(("anchor", "node"), [(3, 17), (17, 3), (0, 24), (9, 10), (10, 9)])
def test_relative_covariance_holds_by_monte_carlo_of_the_batch(
    graph: PoseGraph, rng: np.random.Generator, anchor: int, node: int
) -> None:
    fill(graph, rng)
    factors, values = batch(graph)
    keys = sorted((anchor, node))
    joint = gtsam.Marginals(factors, values).jointMarginalCovariance(keys).fullMatrix()
    v = 0.1 * rng.multivariate_normal(np.zeros(6), joint, 40_000)  # small: to first order
    poses = gtsam.utilities.extractPose2(values)
    sampled = {
        key: se2.compose(poses[key][None], se2.exp(v[:, 3 * i : 3 * i + 3])) for i, key in enumerate(keys)
    }
    T_anchor_node = se2.between(poses[anchor], poses[node])
    offsets = se2.log(se2.between(T_anchor_node[None], se2.between(sampled[anchor], sampled[node])))
    expected = 100.0 * np.cov(offsets.T)
    got = graph.relative_covariance(anchor, node)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(got / scale, expected / scale, atol=0.04)
    assert is_covariance(got)


def test_relative_covariance_on_a_chain_is_the_compound_of_its_edges(graph: PoseGraph) -> None:
    step, cov = np.array([1.0, 0.2, 0.5]), np.diag([0.02, 0.01, 0.03]) ** 2
    graph.start(np.array([5.0, -3.0, 1.0]))
    expected = np.zeros((3, 3))
    for k in range(4):
        graph.add_node(se2.compose(graph.pose(k), step))
        graph.add_edge("match", k, k + 1, step, np.linalg.inv(cov))
        graph.update()
        expected = se2.compound_covariance(expected, step, cov)
    np.testing.assert_allclose(graph.relative_covariance(0, 4), expected, rtol=1e-5)
    np.testing.assert_array_equal(graph.relative_covariance(2, 2), np.zeros((3, 3)))


def test_a_rank_deficient_edge_says_nothing_in_its_weak_direction(graph: PoseGraph) -> None:
    step, cov = np.array([1.0, 0.0, 0.3]), np.diag([0.1, 0.1, 0.05]) ** 2
    graph.start(np.zeros(3))
    graph.add_node(step)
    graph.add_edge("odometry", 0, 1, step, np.linalg.inv(cov))
    weak = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    strong = np.eye(3) - np.outer(weak, weak)
    measured = se2.compose(step, 0.02 * weak)  # wrong, but only where it says nothing
    graph.add_edge("match", 0, 1, measured, 1e4 * strong)
    graph.update()
    got = graph.relative_covariance(0, 1)
    assert weak @ got @ weak == pytest.approx(weak @ cov @ weak, rel=1e-2)
    assert np.linalg.eigvalsh(got)[:2] == pytest.approx(1e-4, rel=0.05)
    np.testing.assert_allclose(se2.between(step, graph.pose(1)), 0.0, atol=1e-3)


def test_an_edge_that_is_taken_out_leaves_no_trace(graph: PoseGraph, rng: np.random.Generator) -> None:
    fill(graph, rng)
    edges, poses, marginals = list(graph.edges), graph.poses(), graph.marginals()
    wrong = []
    for k in (20, 12):
        T = se2.compose(se2.between(poses[2], poses[k]), np.array([1.0, -0.7, 0.4]))
        wrong.append(graph.add_edge("closure", 2, k, T, 10.0 * random_information(rng)))
        graph.update()
    assert np.abs(graph.poses() - poses).max() > 0.05
    graph.remove_edges(wrong)
    assert [id(edge) for edge in graph.edges] == [id(edge) for edge in edges]
    for _ in range(3):
        graph.update()
    assert errors(graph.poses(), poses) == pytest.approx((0.0, 0.0), abs=1e-3)
    np.testing.assert_allclose(graph.marginals(), marginals, rtol=0.02, atol=1e-8)
    # and it goes on from there
    node = graph.add_node(se2.compose(poses[-1], np.array([0.5, 0.0, 0.0])))
    graph.add_edge("odometry", node - 1, node, np.array([0.5, 0.0, 0.0]), random_information(rng))
    graph.update()
    _, values = batch(graph)
    assert errors(graph.poses(), gtsam.utilities.extractPose2(values))[0] < 1e-3


def test_right_edges_may_be_taken_out_too(graph: PoseGraph, rng: np.random.Generator) -> None:
    fill(graph, rng)
    gone = [edge for edge in graph.edges if edge.kind == "closure"][::2]
    graph.remove_edges(gone)
    for _ in range(5):
        graph.update()
    factors, values = batch(graph)
    assert errors(graph.poses(), gtsam.utilities.extractPose2(values))[0] < 1e-3
    marginals = gtsam.Marginals(factors, values)
    expected = np.array([marginals.marginalCovariance(k) for k in range(len(graph))])
    np.testing.assert_allclose(graph.marginals(), expected, rtol=0.02, atol=1e-8)


def test_nodes_and_edges_are_numbered_and_kept(graph: PoseGraph, rng: np.random.Generator) -> None:
    assert len(graph) == 0
    assert graph.start(np.zeros(3)) == 0
    assert graph.add_node(np.array([1.0, 0.0, 0.0])) == 1
    information = random_information(rng)
    graph.add_edge("closure", 0, 1, np.array([1.0, 0.0, 0.0]), information)
    graph.update()
    assert len(graph) == 2
    assert graph.poses().shape == (2, 3)
    assert graph.marginals().shape == (2, 3, 3)
    (edge,) = graph.edges
    assert (edge.kind, edge.from_node, edge.to_node) == ("closure", 0, 1)
    np.testing.assert_array_equal(edge.information, information)


def test_the_first_node_stays_where_the_prior_holds_it(graph: PoseGraph) -> None:
    graph.start(np.array([3.0, -2.0, 3.0]))
    np.testing.assert_allclose(graph.pose(0), [3.0, -2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(graph.marginal(0), PRIOR_STD**2 * np.eye(3), rtol=1e-6)


@pytest.mark.parametrize(
    ("T", "information", "text"),
    [
        ([np.nan, 0.0, 0.0], np.eye(3), "match edge 0-1 is not finite"),
        ([np.inf, 0.0, 0.0], np.eye(3), "match edge 0-1 is not finite"),
        ([1.0, 0.0, 0.0], np.full((3, 3), np.nan), "match edge 0-1 is not finite"),
        ([1.0, 0.0, 0.0], np.zeros((3, 3)), "information of match edge 0-1 is not positive semi-definite"),
        ([1.0, 0.0, 0.0], -np.eye(3), "information of match edge 0-1 is not positive semi-definite"),
        ([1.0, 0.0, 0.0], np.diag([1.0, -0.1, 1.0]), "match edge 0-1 is not positive semi-definite"),
    ],
)
def test_bad_edges_are_refused_and_leave_the_graph_as_it_was(
    graph: PoseGraph, T: list[float], information: FloatArray, text: str
) -> None:
    graph.start(np.zeros(3))
    graph.add_node(np.array([1.0, 0.0, 0.0]))
    with pytest.raises(SlammotError, match=text):
        graph.add_edge("match", 0, 1, np.array(T), information)
    assert graph.edges == []
    graph.add_edge("odometry", 0, 1, np.array([1.0, 0.0, 0.0]), np.eye(3))
    graph.update()
    np.testing.assert_allclose(graph.pose(1), [1.0, 0.0, 0.0], atol=1e-9)


def test_nodes_that_hang_on_nothing_cannot_be_solved(graph: PoseGraph) -> None:
    graph.start(np.zeros(3))
    graph.add_node(np.zeros(3))
    graph.add_node(np.zeros(3))
    graph.add_edge("odometry", 1, 2, np.zeros(3), np.eye(3))
    with pytest.raises(SlammotError, match="the pose graph of 3 nodes cannot be solved"):
        graph.update()


def test_the_graph_has_a_thread_until_it_is_closed() -> None:
    def threads() -> list[threading.Thread]:
        return [thread for thread in threading.enumerate() if thread.name.startswith("pose-graph")]

    n_before, stack = len(threads()), threading.stack_size()
    graph = PoseGraph(PoseGraphConfig())
    assert len(threads()) == n_before + 1
    assert threading.stack_size() == stack
    graph.start(np.zeros(3))
    graph.close()
    assert len(threads()) == n_before
    graph.close()


@pytest.mark.parametrize("name", ["prior_std_m", "prior_std_rad", "relinearize_threshold"])
def test_impossible_graphs_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"PoseGraphConfig.{name} must be positive, not 0.0"):
        PoseGraphConfig(**{name: 0.0})


def test_a_graph_rebuilt_gives_the_same_and_goes_on(graph: PoseGraph, rng: np.random.Generator) -> None:
    fill(graph, rng)
    poses, marginals = graph.poses(), graph.marginals()
    graph.rebuild(poses)
    np.testing.assert_allclose(graph.poses(), poses, atol=1e-5)
    np.testing.assert_allclose(graph.marginals(), marginals, rtol=1e-2, atol=1e-8)
    edge = graph.add_edge("closure", 3, 20, se2.between(poses[3], poses[20]), 1e4 * np.eye(3))
    graph.update()
    graph.remove_edges([edge])
    np.testing.assert_allclose(graph.poses(), poses, atol=1e-3)


def test_a_component_moved_to_where_it_lies_stays_there(graph: PoseGraph) -> None:
    """Half a turn is too much for small steps: the graph is solved from the poses that are given."""
    step, weak, strong = np.array([0.5, 0.1, 0.05]), np.eye(3) / 9.0, 1e4 * np.eye(3)
    graph.start(np.zeros(3))
    for k in range(1, 20):
        graph.add_node(se2.compose(graph.pose(k - 1), step))
        graph.add_edge("odometry", k - 1, k, step, weak if k == 10 else strong)
        graph.update()
    poses = graph.poses()
    T_map_new = np.array([3.0, 4.0, np.pi])
    poses[10:] = se2.compose(T_map_new[None, :], poses[10:])
    for source in (12, 18):
        graph.add_edge("closure", 2, source, se2.between(poses[2], poses[source]), strong)
    graph.rebuild(poses)
    assert max(errors(graph.poses(), poses)) < 0.02


def test_a_snapshot_answers_as_the_graph_would_and_leaves_it_alone(rng: np.random.Generator) -> None:
    """Also with nodes that wait for the next update; what comes later is the same to the last bit."""

    def grow(seed: int, *, look: bool) -> PoseGraph:
        graph, rng = PoseGraph(PoseGraphConfig()), np.random.default_rng(seed)
        pose = np.zeros(3)
        graph.start(pose)
        for k in range(1, 60):
            step = np.array([0.5, 0.0, 0.1]) + rng.normal(0.0, 0.02, 3)
            pose = se2.compose(pose, step + rng.normal(0.0, 0.1, 3))
            graph.add_node(pose)
            graph.add_edge("odometry", k - 1, k, step, random_information(rng))
            if k % 10 == 9:
                graph.add_edge("closure", k - 8, k, rng.normal(0.0, 1.0, 3), 1e-2 * random_information(rng))
            if look:
                snapshot = graph.snapshot()
                assert snapshot.poses().shape == (k + 1, 3)
                assert snapshot.marginals().shape == (k + 1, 3, 3)
                assert graph.snapshot() is snapshot
            if k % 4 == 0:
                graph.update()
        return graph

    seed = int(rng.integers(1 << 30))
    plain, watched = grow(seed, look=False), grow(seed, look=True)
    snapshot = plain.snapshot()
    poses, marginals = snapshot.poses(), snapshot.marginals()
    for graph in (plain, watched):
        np.testing.assert_array_equal(graph.poses(), poses)
        np.testing.assert_array_equal(graph.marginals(), marginals)
        assert len(graph.edges) == len(snapshot.edges)
        graph.close()


@pytest.mark.parametrize("kind", ["closure", "match"])
def test_what_the_smoother_fails_on_is_taken_back_and_noted(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, kind: EdgeKind
) -> None:
    """A smoother that throws at a certain edge, half of its work done, as an indeterminate system makes it."""

    class Fails(gtsam.ISAM2):
        def update(self, *arguments: Any) -> Any:
            result: Any = super().update(*arguments)
            if any(edge is bad for edge in graph._waiting):
                raise RuntimeError("Indeterminant linear system detected while working near variable 7")
            return result

    config = PoseGraphConfig(relinearize_threshold=1e-4)
    plain = PoseGraph(config)
    fill(plain, np.random.default_rng(5))
    bad: GraphEdge | None = None
    monkeypatch.setattr(gtsam, "ISAM2", Fails)
    graph = PoseGraph(config)
    fill(graph, np.random.default_rng(5))
    node = graph.add_node(se2.compose(graph.pose(24), np.array([0.5, 0.0, 0.0])))
    graph.add_edge("odometry", 24, node, np.array([0.5, 0.0, 0.0]), random_information(rng))
    bad = graph.add_edge(kind, 3, node, np.array([9.0, 9.0, 2.0]), random_information(rng))
    graph.update()
    assert [edge for edge, _ in graph.dropped] == [bad]
    assert "near variable 7" in graph.dropped[0][1]
    assert bad not in graph.edges
    assert max(errors(graph.poses()[:25], plain.poses())) < 1e-3
    np.testing.assert_allclose(graph.marginals()[:25], plain.marginals(), rtol=0.02, atol=3e-4)
    # and it goes on from there
    edge = graph.add_edge("closure", 3, 20, se2.between(*graph.poses()[[3, 20]]), 1e4 * np.eye(3))
    graph.update()
    graph.remove_edges([edge, bad])
    assert len(graph.dropped) == 1
    graph.close()
    plain.close()


def test_an_edge_that_must_not_enter_is_noted(graph: PoseGraph) -> None:
    graph.start(np.zeros(3))
    graph.add_node(np.array([1.0, 0.0, 0.0]))
    assert graph.try_edge("match", 0, 1, np.zeros(3), np.diag([1.0, np.inf, 1.0])) is None
    assert graph.try_edge("odometry", 0, 1, np.array([1.0, 0.0, 0.0]), np.eye(3)) in graph.edges
    assert [text for _, text in graph.dropped] == ["match edge 0-1 is not finite"]
    with pytest.raises(SlammotError, match="the pose of node 2 is not finite"):
        graph.add_node(np.array([np.nan, 0.0, 0.0]))
    np.testing.assert_allclose(graph.poses(), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], atol=1e-9)
