import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from slammot_graph.graph import error_sources as sources
from slammot_graph.graph.common_errors import common_error
from slammot_graph.graph.error_sources import NodeError, solution_covariances

N, WINDOW = 9, 3
STEP = np.array([0.5, 0.05, 0.2])
TRUTH = np.array([[0.0, 0.0, 0.0]])
for _ in range(N - 1):
    TRUTH = np.vstack([TRUTH, se2.compose(TRUTH[-1], STEP)])
ODOMETRY_ROOT = np.diag([0.02, 0.01, 0.01])
ROOT = np.array([[0.003, 0.001, 0.0], [0.001, 0.004, 0.0], [0.0, 0.0, 0.002]])
COMMON_ROOT = np.diag([0.001, 0.002, 0.0005])
SHARE = np.diag([0.9, 0.8, 0.95])
COMMON = common_error(STEP, np.array([0.01, 0.005, 0.002, 0.01]))
CLOSURE_COV = np.diag([0.003, 0.002, 0.001]) ** 2
GRAPH_INFORMATION = np.diag([1e4, 2e4, 1e5])
ODOMETRY_INFORMATION = np.linalg.inv(ODOMETRY_ROOT @ ODOMETRY_ROOT.T)


def onto(i: int, j: int) -> FloatArray:
    """What an error of node i is in the body frame of node j."""
    return np.asarray(se2.adjoint(se2.between(TRUTH[j], TRUTH[i])))


def made_on(k: int) -> list[int]:
    """Nodes of the local map that node k is matched onto: the first of them is its anchor."""
    return list(range(WINDOW * max((k - 1) // WINDOW - 1, 0), k))


def node_errors() -> dict[int, NodeError]:
    errors = {}
    for k in range(1, N):
        weights = np.arange(1.0, len(made_on(k)) + 1.0)
        gains = np.array([w / weights.sum() * onto(m, k) for w, m in zip(weights, made_on(k), strict=True)])
        errors[k] = NodeError(
            np.array(made_on(k)), gains, ROOT, COMMON_ROOT, SHARE, np.eye(3) - SHARE, STEP, ODOMETRY_ROOT
        )
    return errors


def solved(noise: FloatArray, size: float) -> tuple[FloatArray, list[GraphEdge]]:
    """The graph's solution where each source errs by so many standard deviations, times a size.

    Sources: matches, shared noise, odometry (each 3 a node), the closure (3), common parameters (4).
    """
    own, shared, odometry = (size * part.reshape(N, 3) for part in np.split(noise[: 9 * N], 3))
    closure, common = size * noise[9 * N : 9 * N + 3], size * noise[9 * N + 3 :]
    local, graph = np.zeros((N, 3)), PoseGraph(PoseGraphConfig())
    graph.start(TRUTH[0])
    for k, error in node_errors().items():
        anchor = int(error.nodes[0])
        step = ODOMETRY_ROOT @ odometry[k] + COMMON @ common
        neighbours = shared[max(k - sources.N_NEIGHBOURS + 1, 0) : k + 1].sum(axis=0)
        matched = np.einsum("mij,mj->i", error.gains, local[error.nodes]) + ROOT @ own[k]
        matched += COMMON_ROOT @ neighbours
        local[k] = SHARE @ matched + error.propagated @ (onto(k - 1, k) @ local[k - 1] + step)
        graph.add_node(TRUTH[k])
        graph.add_edge("odometry", k - 1, k, se2.compose(STEP, se2.exp(step)), ODOMETRY_INFORMATION)
        told = se2.exp(matched - onto(anchor, k) @ local[anchor])
        graph.add_edge(
            "match", anchor, k, se2.compose(se2.between(TRUTH[anchor], TRUTH[k]), told), GRAPH_INFORMATION
        )
    first, last = 0, made_on(N - 1)[0]
    deformed = np.sqrt(np.diag(CLOSURE_COV)) * closure
    for anchor, sign in ((first, 1.0), (last, -1.0)):
        members = [*made_on(max(k for k in range(1, N) if made_on(k)[0] == anchor)), 0]
        members[-1] = members[-2] + 1
        mean = np.mean([onto(m, last) @ local[m] for m in members], axis=0)
        deformed = deformed + sign * (mean - onto(anchor, last) @ local[anchor])
    told = se2.compose(se2.between(TRUTH[first], TRUTH[last]), se2.exp(deformed))
    graph.add_edge("closure", first, last, told, GRAPH_INFORMATION)
    poses, edges = graph.poses(), graph.edges
    graph.close()
    return poses, edges


def test_covariances_are_what_each_source_does_to_the_graph() -> None:
    n_sources, size = 9 * N + 7, 1e-3
    nodes, edges = solved(np.zeros(n_sources), size)
    expected = np.zeros((N, 3, 3))
    for source in np.eye(n_sources):
        error = se2.log(se2.between(nodes, solved(source, size)[0])) / size
        expected += error[:, :, None] * error[:, None, :]
    covs = solution_covariances(
        nodes,
        edges,
        node_errors(),
        dict.fromkeys(range(1, N), COMMON),
        np.arange(N),
        closure_covs={edges[-1]: CLOSURE_COV},
    )
    np.testing.assert_allclose(covs, expected, rtol=2e-2, atol=1e-2 * expected[-1].diagonal().min())
    some = solution_covariances(nodes, edges, node_errors(), {}, np.array([N - 1, 3]))
    assert some.shape == (2, 3, 3)
    assert np.trace(some[0]) < np.trace(covs[-1])


def test_factors_of_unknown_sources_err_as_their_information_says() -> None:
    nodes, edges = solved(np.zeros(9 * N + 7), 0.0)
    graph = PoseGraph(PoseGraphConfig())
    graph.start(nodes[0])
    for k in range(1, N):
        graph.add_node(nodes[k])
    for edge in edges:
        graph.add_edge(edge.kind, edge.from_node, edge.to_node, edge.T_from_to, edge.information)
    expected = graph.marginals()
    graph.close()
    covs = solution_covariances(nodes, edges, {}, {}, np.arange(N))
    np.testing.assert_allclose(covs[1:], expected[1:], rtol=1e-3, atol=1e-7)


def test_a_quieter_odometry_gives_smaller_covariances() -> None:
    nodes, edges = solved(np.zeros(9 * N + 7), 0.0)
    asked = np.arange(1, N)
    usual, quiet = (solution_covariances(nodes, edges, node_errors(), {}, asked, s) for s in (1.0, 0.1))
    assert (np.linalg.eigvalsh(usual - quiet) > -1e-12).all()
    assert np.trace(quiet[-1]) < 0.9 * np.trace(usual[-1])


@pytest.mark.parametrize("offset_m", [0.005, 0.1])
def test_a_closure_that_disagrees_errs_by_what_it_disagrees(offset_m: float) -> None:
    nodes, edges = solved(np.zeros(9 * N + 7), 0.0)
    wrong = GraphEdge(
        kind="closure",
        from_node=edges[-1].from_node,
        to_node=edges[-1].to_node,
        T_from_to=se2.compose(edges[-1].T_from_to, np.array([0.0, offset_m, 0.0])),
        information=GRAPH_INFORMATION,
    )
    right, disagreeing = (
        solution_covariances(
            nodes, [*edges[:-1], one], node_errors(), {}, np.array([N - 1]), closure_covs={one: CLOSURE_COV}
        )[0]
        for one in (edges[-1], wrong)
    )
    if offset_m < 0.02:  # within what the graph expects
        np.testing.assert_allclose(disagreeing, right)
    else:
        assert np.trace(disagreeing) > 2.0 * np.trace(right)


def test_a_node_alone_has_no_error() -> None:
    covs = solution_covariances(np.zeros((1, 3)), [], {}, {}, np.array([0]))
    np.testing.assert_array_equal(covs, np.zeros((1, 3, 3)))
