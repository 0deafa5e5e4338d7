from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.error_sources import N_NEIGHBOURS
from slammot_graph.localization import node_errors
from slammot_graph.localization.node_errors import FEW, NodeErrors, node_error
from slammot_graph.mapping.local_map import Keyframe
from tests.localization.matches import FAILED, match_with

COV_ODOMETRY = np.diag([0.015, 0.015, 0.02]) ** 2
NOTHING = np.empty((0, 2))


def keyframe(node: int, x: float) -> Keyframe:
    return Keyframe(
        node=node,
        T_local_base=np.array([x, 0.1 * x, 0.1 * x]),
        points_base=NOTHING,
        normals_base=NOTHING,
        laser_base=np.zeros(2),
    )


KEYFRAMES = [keyframe(4, 1.0), keyframe(5, 1.5), keyframe(-1, 2.0), keyframe(6, 2.5)]
T_NODE = np.array([3.0, 0.2, 0.4])
T_LAST_NODE = se2.between(KEYFRAMES[-1].T_local_base, T_NODE)
TELLS = np.diag([2e5, 1e5, 2e6])
MATCH = match_with(
    cov=np.linalg.inv(TELLS),
    information=TELLS,
    hessian_information=TELLS,
    cov_correlated=0.3 * np.linalg.inv(TELLS),
    map_scatter=np.array([np.diag([w, 2.0, 9.0]) + 0.1 for w in (1.0, 5.0, 90.0, 40.0)]),
)
ALONG = np.diag([0.0, 1.0, 1.0])
DOWN_A_CORRIDOR = replace(
    MATCH,
    status="degenerate",
    information=ALONG @ TELLS @ ALONG,
    hessian_information=ALONG @ TELLS @ ALONG,
    cov_correlated=ALONG @ MATCH.cov_correlated @ ALONG,
    map_scatter=np.array([np.diag([1e-6, 20.0, 90.0])] * 4),
)


@pytest.mark.parametrize("match", [MATCH, DOWN_A_CORRIDOR, FAILED, None])
def test_an_error_of_the_whole_local_frame_is_one_of_the_node(match: object) -> None:
    error = node_error(match, KEYFRAMES, T_NODE, T_LAST_NODE, COV_ODOMETRY)  # type: ignore[arg-type]
    shift = np.array([0.3, -0.2, 0.1])  # of the local frame

    def at(T: FloatArray) -> FloatArray:
        return np.asarray(se2.adjoint(se2.inverse(T)) @ shift)

    of_nodes = {k.node: at(k.T_local_base) for k in KEYFRAMES}
    matched = sum(
        (g @ of_nodes[n] for n, g in zip(error.nodes.tolist(), error.gains, strict=True)), np.zeros(3)
    )
    last = se2.adjoint(se2.inverse(T_LAST_NODE)) @ of_nodes[6]
    np.testing.assert_allclose(error.share @ matched + error.propagated @ last, at(T_NODE), atol=1e-12)


def test_noise_is_the_matchs_and_a_part_of_it_is_shared() -> None:
    error = node_error(MATCH, KEYFRAMES, T_NODE, T_LAST_NODE, COV_ODOMETRY)
    shared = N_NEIGHBOURS * error.common_root @ error.common_root.T
    np.testing.assert_allclose(shared, MATCH.cov_correlated, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(error.root @ error.root.T + shared, MATCH.cov, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(error.odometry_root @ error.odometry_root.T, COV_ODOMETRY, atol=1e-15)
    assert error.nodes.tolist() == [4, 5, 5, 6]  # one that is no node has the error of the one before
    assert (np.linalg.eigvals(error.share).real > 0.9).all()


def test_down_a_corridor_the_odometry_carries_the_error() -> None:
    error = node_error(DOWN_A_CORRIDOR, KEYFRAMES, T_NODE, T_LAST_NODE, COV_ODOMETRY)
    assert error.propagated[0, 0] == pytest.approx(1.0)
    assert np.abs(error.propagated[1:, 1:]).max() < 0.1
    assert not (error.root @ error.root.T)[0].any()
    for match in (None, FAILED, replace(MATCH, map_scatter=None)):
        unmatched = node_error(match, KEYFRAMES, T_NODE, T_LAST_NODE, COV_ODOMETRY)
        np.testing.assert_array_equal(unmatched.propagated, np.eye(3))
        assert not len(unmatched.nodes)


def drive(n: int, std: float) -> NodeErrors:
    """Matched nodes whose odometry errs by so many of its standard deviations."""
    rng, errors = np.random.default_rng(3), NodeErrors()
    for k in range(n):
        noise = std * np.sqrt(COV_ODOMETRY.diagonal()) * rng.normal(size=3)
        T_by_matches = se2.compose(T_LAST_NODE, noise)
        errors.add(7 + k, MATCH, KEYFRAMES, T_NODE, T_LAST_NODE, COV_ODOMETRY, T_by_matches)
    return errors


def test_the_odometrys_noise_is_measured_against_the_matches() -> None:
    assert drive(0, 1.0).odometry_scale == 1.0
    assert drive(400, 0.4).odometry_scale == pytest.approx(0.4**2, rel=0.2)
    assert drive(400, 1.5).odometry_scale == pytest.approx(1.5**2, rel=0.2)
    few = drive(2, 0.01).odometry_scale
    assert few == pytest.approx(FEW / (FEW + 6.0), rel=0.1)


def test_what_no_match_tells_of_says_nothing_of_the_odometry() -> None:
    errors = NodeErrors()
    for k in range(20):
        errors.add(k, None, KEYFRAMES, T_NODE, T_LAST_NODE, COV_ODOMETRY, T_LAST_NODE)
    assert errors.odometry_scale == 1.0


def test_of_a_very_long_run_the_sources_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_errors, "MOST_NODES", 5)
    errors = drive(7, 1.0)
    assert errors.of_nodes is None
    assert errors.covariances(np.zeros((14, 3)), [], {}, {}) is None


def test_the_first_node_of_a_local_map_has_no_error() -> None:
    errors = NodeErrors()
    errors.add(3, None, [], T_NODE, T_LAST_NODE, COV_ODOMETRY, T_LAST_NODE)
    assert errors.of_nodes == {}
