import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.scan_poses import ScanPoses


def random_covs(rng: np.random.Generator, n: int) -> FloatArray:
    roots = rng.normal(0.0, 0.1, (n, 3, 3))
    return np.asarray(roots @ np.swapaxes(roots, 1, 2))


@given(seed=st.integers(0, 2**32 - 1), n_scans=st.integers(1, 12))
def test_a_scan_is_known_as_its_node_is_and_by_what_it_knows_less_of_the_anchor(
    seed: int, n_scans: int
) -> None:
    rng = np.random.default_rng(seed)
    nodes, marginals = rng.normal(0.0, [9.0, 9.0, 2.0], (5, 3)), random_covs(rng, 5)
    at_node, at_anchor = np.sort(rng.integers(0, 5, n_scans)).tolist(), rng.integers(0, 5, n_scans).tolist()
    T_node_base, T_anchor_base = rng.normal(0.0, [3.0, 3.0, 2.0], (2, n_scans, 3))
    covs = random_covs(rng, n_scans)
    scan_poses = ScanPoses()
    for k in range(n_scans):
        assert len(scan_poses) == k
        scan_poses.append(at_node[k], T_node_base[k], at_anchor[k], T_anchor_base[k], covs[k])
    T_map_base, cov_map = scan_poses.trajectory(nodes, marginals)
    assert T_map_base.shape == (n_scans, 3)
    assert cov_map.shape == (n_scans, 3, 3)
    for k in range(n_scans):
        np.testing.assert_allclose(T_map_base[k], se2.compose(nodes[at_node[k]], T_node_base[k]), atol=1e-12)
        A = se2.adjoint(se2.inverse(T_node_base[k]))
        first = at_node.index(at_node[k])
        has_same_anchor = at_anchor[first] == at_anchor[k] != at_node[k]
        known = A @ covs[first] @ A.T if has_same_anchor else np.zeros((3, 3))
        rest = cov_map[k] - A @ marginals[at_node[k]] @ A.T
        assert np.linalg.eigvalsh(rest).min() > -1e-9
        assert np.linalg.eigvalsh(rest - (covs[k] - known)).min() > -1e-9
        if not has_same_anchor:
            np.testing.assert_allclose(rest, covs[k], atol=1e-7)


def test_what_is_added_is_kept_as_it_was() -> None:
    scan_poses, T, cov = ScanPoses(), np.array([1.0, 2.0, 0.5]), np.eye(3)
    scan_poses.append(0, T, 0, T, cov)
    T[:], cov[:] = 7.0, 7.0
    T_map_base, cov_map = scan_poses.trajectory(np.zeros((1, 3)), np.zeros((1, 3, 3)))
    np.testing.assert_array_equal(T_map_base, [[1.0, 2.0, 0.5]])
    np.testing.assert_allclose(cov_map, [np.eye(3)], atol=1e-7)
