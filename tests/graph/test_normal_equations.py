import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.normal_equations import NormalEquations

N = 6


def plain(nodes: FloatArray, edges: list[GraphEdge]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Jacobian (3 e, 3 n), weights (3 e, 3 e) and inverse of the normal matrix (3 n, 3 n), all dense."""
    J, W = np.zeros((3 * len(edges), 3 * N)), np.zeros((3 * len(edges), 3 * len(edges)))
    for k, edge in enumerate(edges):
        i, j, row = edge.from_node, edge.to_node, slice(3 * k, 3 * k + 3)
        J[row, 3 * i : 3 * i + 3] = -se2.adjoint(se2.between(nodes[j], nodes[i]))
        J[row, 3 * j : 3 * j + 3] = np.eye(3)
        W[row, row] = edge.information
    held = np.where(np.arange(3 * N) < 3, 1e8, 0.0) + 1e-6
    return J, W, np.asarray(np.linalg.inv(J.T @ W @ J + np.diag(held)), np.float64)


@pytest.fixture
def graph(rng: np.random.Generator) -> tuple[FloatArray, list[GraphEdge]]:
    nodes = rng.normal(size=(N, 3))
    pairs = [*((k, k + 1) for k in range(N - 1)), (0, 4), (1, 5)]
    roots = rng.normal(size=(len(pairs), 3, 3)) + 3.0 * np.eye(3)
    return nodes, [
        GraphEdge(
            kind="match",
            from_node=i,
            to_node=j,
            T_from_to=se2.between(nodes[i], nodes[j]),
            information=root @ root.T,
        )
        for (i, j), root in zip(pairs, roots, strict=True)
    ]


def test_errors_of_nodes_are_those_of_dense_least_squares(
    graph: tuple[FloatArray, list[GraphEdge]], rng: np.random.Generator
) -> None:
    nodes, edges = graph
    J, W, inverse = plain(nodes, edges)
    z = rng.normal(size=(len(edges), 3, 2))
    expected = inverse @ J.T @ W @ z.reshape(-1, 2)
    np.testing.assert_allclose(
        NormalEquations(nodes, edges).node_errors(z).reshape(-1, 2), expected, atol=1e-6
    )


def test_weights_are_the_transpose(
    graph: tuple[FloatArray, list[GraphEdge]], rng: np.random.Generator
) -> None:
    nodes, edges = graph
    J, W, inverse = plain(nodes, edges)
    asked = rng.normal(size=(N, 3, 4))
    expected = W @ J @ inverse @ asked.reshape(-1, 4)
    np.testing.assert_allclose(
        NormalEquations(nodes, edges).weights(asked).reshape(-1, 4), expected, atol=1e-6
    )


def test_covariance_of_a_relative_pose(graph: tuple[FloatArray, list[GraphEdge]]) -> None:
    nodes, edges = graph
    J, _, inverse = plain(nodes, edges)
    equations = NormalEquations(nodes, edges)
    for k in range(len(edges)):
        row = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(equations.covariance_of_edge(k), J[row] @ inverse @ J[row].T, atol=1e-6)


def test_a_graph_without_edges_holds_its_node() -> None:
    errors = NormalEquations(np.zeros((1, 3)), []).node_errors(np.zeros((0, 3, 2)))
    np.testing.assert_array_equal(errors, np.zeros((1, 3, 2)))
