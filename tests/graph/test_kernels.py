import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.graph import _kernels

HELD = -1


def block_covariances(
    from_nodes: IntArray, to_nodes: IntArray, T_from_to: FloatArray, informations: FloatArray, n_nodes: int
) -> tuple[bool, FloatArray]:
    out = np.full((n_nodes, 3, 3), np.nan)
    return _kernels.block_covariances(from_nodes, to_nodes, T_from_to, informations, out), out


def plain_block_covariances(
    from_nodes: IntArray, to_nodes: IntArray, T_from_to: FloatArray, informations: FloatArray, n_nodes: int
) -> FloatArray:
    """All nodes' information with the held one last, its rows and columns left out, and a dense inverse."""
    whole = np.zeros((3 * n_nodes + 3, 3 * n_nodes + 3))
    for a, b, T, information in zip(from_nodes, to_nodes, T_from_to, informations, strict=True):
        J = np.zeros((3, 3 * n_nodes + 3))
        J[:, 3 * (a % (n_nodes + 1)) :][:, :3] = -se2.adjoint(se2.inverse(T))
        J[:, 3 * (b % (n_nodes + 1)) :][:, :3] = np.eye(3)
        whole += J.T @ information @ J
    cov = np.linalg.inv(whole[:-3, :-3])
    return np.array([cov[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n_nodes)])


def random_information(rng: np.random.Generator, rank: int = 3) -> FloatArray:
    root = rng.normal(size=(3, rank)) * np.array([100.0, 60.0, 300.0])[:, None]
    information: FloatArray = root @ root.T
    return information


@given(seed=st.integers(0, 2**32 - 1), n_nodes=st.integers(1, 7), n_more=st.integers(0, 8))
def test_covariances_are_the_diagonal_blocks_of_a_dense_inverse(seed: int, n_nodes: int, n_more: int) -> None:
    """Each node is attached to an earlier one or the held one, by either end; more edges, of any rank, close loops."""
    rng = np.random.default_rng(seed)
    ends = [[k, int(rng.integers(-1, k))] for k in range(n_nodes)]
    ends += [(rng.choice(n_nodes + 1, 2, replace=False) - 1).tolist() for _ in range(n_more)]
    nodes = rng.permuted(np.array(ends), axis=1)
    T_from_to = rng.normal(0.0, [3.0, 3.0, 2.0], (len(nodes), 3))
    firm = [random_information(rng) + np.diag([1e3, 1e3, 1e4]) for _ in range(n_nodes)]
    informations = np.array(firm + [random_information(rng, int(rng.integers(0, 4))) for _ in range(n_more)])
    order = rng.permutation(len(nodes))
    edges = nodes[order, 0].copy(), nodes[order, 1].copy(), T_from_to[order], informations[order]
    is_determined, covs = block_covariances(*edges, n_nodes)
    assert is_determined
    expected = plain_block_covariances(*edges, n_nodes)
    for cov, his in zip(covs, expected, strict=True):
        np.testing.assert_allclose(cov, his, rtol=1e-6, atol=1e-7 * his.max())


def chain(*informations: FloatArray) -> bool:
    """Tell whether nodes in a row behind the held one are determined."""
    n = len(informations)
    nodes = np.array([HELD, *range(n)])
    T_from_to = np.tile([0.5, 0.0, 0.0], (n, 1))
    return block_covariances(nodes[:-1].copy(), nodes[1:].copy(), T_from_to, np.array(informations), n)[0]


def test_a_graph_that_leaves_a_node_undetermined_is_told() -> None:
    firm = np.diag([4.0, 9.0, 16.0])
    assert chain(firm, firm)
    for weak in ([0.0, 0.0, 0.0], [4.0, 9.0, 0.0], [0.0, 9.0, 16.0], [4.0, -9.0, 16.0], [np.nan, 9.0, 16.0]):
        assert not chain(firm, np.diag(weak))
        assert not chain(np.diag(weak), firm)


def test_a_graph_on_no_held_node_is_told() -> None:
    nodes, T_from_to = np.array([0, 1]), np.array([[0.5, 0.0, 0.0]])
    is_determined, _ = block_covariances(nodes[:1], nodes[1:], T_from_to, np.eye(3)[None], 2)
    assert not is_determined
