import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from slammot_graph.graph.common_errors import common_error, solution_errors

STEP = np.array([0.5, 0.0, 0.02])
NO_MATCH = np.zeros((3, 3))


def solved(
    scale: float, n: int, match_information: FloatArray, is_closed: bool
) -> tuple[FloatArray, list[GraphEdge]]:
    """A drive whose odometry is wrong by a factor, with matches of the truth to every fifth node."""
    graph = PoseGraph(PoseGraphConfig())
    graph.start(se2.IDENTITY)
    truth = [se2.IDENTITY]
    for k in range(1, n):
        truth.append(se2.compose(truth[-1], STEP))
        told = STEP * [scale, scale, 1.0]
        graph.add_node(truth[-1])
        graph.add_edge("odometry", k - 1, k, told, np.diag([1e3, 1e3, 1e5]))
        if match_information.any():
            anchor = 5 * ((k - 1) // 5)
            graph.add_edge("match", anchor, k, se2.between(truth[anchor], truth[k]), match_information)
    if is_closed:
        graph.add_edge("closure", 0, n - 1, truth[-1], 1e4 * np.eye(3))
    poses, edges = graph.poses(), graph.edges
    graph.close()
    return poses, edges


@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize("match_information", [NO_MATCH, np.diag([1e2, 1e5, 1e6]), np.diag([0.0, 1e5, 1e6])])
def test_errors_are_what_a_wrong_scale_does_to_the_graph(
    match_information: FloatArray, is_closed: bool
) -> None:
    n, std = 24, 0.001
    right, edges = solved(1.0, n, match_information, is_closed)
    wrong, _ = solved(1.0 + std, n, match_information, is_closed)
    of_factors = {k: common_error(STEP, np.array([std, 0.0, 0.0, 0.0])) for k in range(1, n)}
    errors = solution_errors(right, edges, of_factors)
    largest = np.abs(errors[:, :, 0]).max()
    assert largest > (4e-5 if is_closed else 5e-3)
    np.testing.assert_allclose(errors[:, :, 0], se2.log(se2.between(right, wrong)), atol=1e-4 * largest)
    assert not errors[:, :, 1:].any()


@pytest.mark.parametrize("parameter", range(4))
def test_an_increment_errs_as_its_parameters_say(parameter: int) -> None:
    x, y, turn = increment = np.array([0.3, 0.1, 0.2])
    stds = np.zeros(4)
    stds[parameter] = std = 1e-4
    c, s = np.cos(std), np.sin(std)
    told = [
        [x * (1 + std), y * (1 + std), turn],
        [c * x - s * y, s * x + c * y, turn],
        [x, y, turn + std * np.hypot(x, y)],
        [x, y, turn * (1 + std)],
    ][parameter]
    expected = se2.log(se2.between(increment, np.array(told)))
    np.testing.assert_allclose(common_error(increment, stds)[:, parameter], expected, atol=1e-8)


def test_without_odometry_nothing_is_in_common() -> None:
    right, edges = solved(1.0, 6, NO_MATCH, is_closed=False)
    assert not solution_errors(right, edges, {}).any()
    assert solution_errors(np.empty((0, 3)), [], {}).shape == (0, 3, 4)


def test_each_run_has_parameters_of_its_own() -> None:
    n, second = 12, 5
    nodes, edges = solved(1.0, n, NO_MATCH, is_closed=True)
    of_factors = {k: common_error(STEP, np.array([0.001, 0.0, 0.0, 0.0])) for k in range(1, n)}
    errors = solution_errors(nodes, edges, of_factors, [0, second])
    assert errors.shape == (n, 3, 8)
    for run, own in enumerate((range(1, second), range(second, n))):
        alone = solution_errors(nodes, edges, {k: of_factors[k] for k in own})
        np.testing.assert_allclose(errors[:, :, 4 * run : 4 * run + 4], alone, atol=1e-12)
    np.testing.assert_allclose(
        errors[:, :, 0] + errors[:, :, 4], solution_errors(nodes, edges, of_factors)[:, :, 0], atol=1e-12
    )
