import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.common_errors import common_error, solution_errors
from slammot_graph.localization.common_errors import CommonErrors

STEP = np.array([0.3, 0.0, 0.0])
STDS = np.array([0.01, 0.0, 0.002, 0.0])
COV = np.diag([0.01, 0.01, 0.005]) ** 2
N_PER_MAP = 7


def driven(n: int, match_information: FloatArray) -> tuple[CommonErrors, FloatArray, int]:
    """A drive along x: errors propagated, and the covariances (n, 3, 3) by the whole graph; the last anchor."""
    errors = CommonErrors()
    errors.start_local_map(0, 0, np.zeros((3, 3)))
    nodes = np.array([[0.3 * k, 0.0, 0.0] for k in range(n)])
    edges, anchor = [], 0
    for k in range(1, n):
        errors.move(k, STEP, COV, STDS)
        T_anchor_node = se2.between(nodes[anchor], nodes[k])
        errors.match(k, anchor, T_anchor_node, match_information)
        for kind, begin, information in (
            ("odometry", k - 1, np.linalg.inv(COV)),
            ("match", anchor, match_information),
        ):
            T = se2.between(nodes[begin], nodes[k])
            edges.append(
                GraphEdge(kind=kind, from_node=begin, to_node=k, T_from_to=T, information=information)  # type: ignore[arg-type]
            )
        if k % N_PER_MAP == 0:
            anchor = k
            errors.start_local_map(anchor, k, np.zeros((3, 3)))
    of_factors = {k: common_error(STEP, STDS) for k in range(1, n)}
    solution = solution_errors(nodes, edges, of_factors)
    return errors, solution @ np.swapaxes(solution, 1, 2), anchor


def test_without_matches_the_error_grows_with_the_distance() -> None:
    errors, by_graph, anchor = driven(50, np.zeros((3, 3)) + 1e-3 * np.eye(3))
    cov = errors.cov(anchor)
    assert cov[0, 0] == pytest.approx((0.01 * 0.3 * anchor) ** 2, rel=0.05)
    np.testing.assert_allclose(cov, by_graph[anchor], rtol=0.1, atol=1e-5)


def test_matches_take_it_to_nothing_in_the_directions_they_tell() -> None:
    errors, by_graph, anchor = driven(50, np.diag([0.0, 1e6, 1e8]))
    cov = errors.cov(anchor)
    assert cov[0, 0] == pytest.approx((0.01 * 0.3 * anchor) ** 2, rel=0.01)
    assert cov[2, 2] < 1e-7
    np.testing.assert_allclose(cov[0, 0], by_graph[anchor, 0, 0], rtol=0.01)


def test_a_closed_loop_takes_over_what_the_graph_says() -> None:
    errors, _, anchor = driven(50, np.diag([0.0, 1e6, 1e8]))
    solution = np.zeros((50, 3, 4))
    solution[:, 0, 0] = np.arange(50) * 1e-3
    errors.close_loop(solution)
    np.testing.assert_allclose(errors.cov(anchor)[0, 0], (anchor * 1e-3) ** 2)
    assert not errors.cov(-7).any()
