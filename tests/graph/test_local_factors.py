from collections.abc import Iterator

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import LocalFactors, PoseGraph, PoseGraphConfig

STEP = np.array([0.3, 0.02, 0.15])
COV_ODOMETRY = np.diag([0.02, 0.015, 0.01]) ** 2
FIRM = 1e8 * np.eye(3)
BARE = 1e-4 * np.eye(3)


INFORMATION_ODOMETRY = np.linalg.inv(COV_ODOMETRY)


def poses_of(n: int, step: FloatArray = STEP) -> FloatArray:
    poses = [np.array([4.0, -1.0, 2.8])]
    for _ in range(n - 1):
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


def random_information(rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(3, 3)) * [100.0, 60.0, 300.0]
    return np.asarray(root.T @ root)


def filled(informations: list[FloatArray], step: FloatArray = STEP) -> LocalFactors:
    """A chain of keyframes, each with its match but the first."""
    factors, poses = LocalFactors(), poses_of(len(informations) + 1, step)
    factors.start(poses[0])
    for k, information in enumerate(informations, start=1):
        factors.add(step, INFORMATION_ODOMETRY, poses[k], information)
    return factors


@pytest.fixture
def graph() -> Iterator[PoseGraph]:
    graph = PoseGraph(PoseGraphConfig(prior_std_m=1.0, prior_std_rad=1.0))
    yield graph
    graph.close()


@pytest.mark.parametrize("anchor", [0, 1, 4])
def test_covariances_are_those_of_the_pose_graph_with_a_node_for_the_map(
    graph: PoseGraph, rng: np.random.Generator, anchor: int
) -> None:
    informations = [random_information(rng) for _ in range(6)]
    informations[2] = np.zeros((3, 3))  # no match
    informations[4] = np.diag([0.0, 3e4, 2e5])  # a corridor
    poses = poses_of(7)
    # the map is node 0 of the graph, keyframe k node k + 1; what lies before the anchor does not count
    node_of = {keyframe: 1 + n for n, keyframe in enumerate(range(anchor, 7))}
    graph.start(np.zeros(3))
    for keyframe, node in node_of.items():
        graph.add_node(poses[keyframe])
        match = FIRM if keyframe == 0 else informations[keyframe - 1] + BARE
        graph.add_edge("match", 0, node, poses[keyframe], match)
        if keyframe > anchor:
            graph.add_edge("odometry", node - 1, node, STEP, INFORMATION_ODOMETRY)
    graph.update()
    covs = filled(informations).of_latest(7 - anchor)
    assert covs.shape == (7 - anchor, 3, 3)
    np.testing.assert_array_equal(covs[0], np.zeros((3, 3)))
    for keyframe, cov in zip(range(anchor + 1, 7), covs[1:], strict=True):
        expected = graph.relative_covariance(node_of[anchor], node_of[keyframe])
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(cov / scale, expected / scale, atol=0.01)


def test_where_the_whole_lies_does_not_matter(rng: np.random.Generator) -> None:
    informations = [random_information(rng) for _ in range(5)]
    expected = filled(informations).of_latest(4)
    factors, far = LocalFactors(), np.array([50.0, 20.0, -2.0])
    poses = se2.compose(far[None], poses_of(6))
    factors.start(poses[0])
    for k, information in enumerate(informations, start=1):
        factors.add(STEP, INFORMATION_ODOMETRY, poses[k], information)
    np.testing.assert_allclose(factors.of_latest(4), expected, rtol=1e-4, atol=1e-10)


def test_without_matches_the_odometry_adds_up() -> None:
    covs = filled([np.zeros((3, 3))] * 5).of_latest(6)
    expected = np.zeros((3, 3))
    for cov in covs[1:]:
        expected = se2.compound_covariance(expected, STEP, COV_ODOMETRY)
        np.testing.assert_allclose(cov, expected, rtol=1e-3, atol=1e-9)


def test_what_lies_before_the_anchor_is_forgotten(rng: np.random.Generator) -> None:
    informations = [random_information(rng) for _ in range(8)]
    others = [random_information(rng) for _ in range(3)] + informations[3:]
    factors, twin = filled(informations), filled(others)
    np.testing.assert_allclose(factors.of_latest(5)[1:], twin.of_latest(5)[1:], rtol=1e-9)
    # again from the same anchor, and over it to a later one
    np.testing.assert_allclose(factors.of_latest(5), twin.of_latest(5), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(factors.of_latest(3), filled(informations).of_latest(3), rtol=1e-9, atol=1e-15)
    assert len(factors.of_latest(1)) == 1


def test_beginning_anew_forgets_everything(rng: np.random.Generator) -> None:
    informations = [random_information(rng) for _ in range(3)]
    factors = filled([random_information(rng) for _ in range(6)])
    factors.start(poses_of(1)[0])
    poses = poses_of(4)
    for k, information in enumerate(informations, start=1):
        factors.add(STEP, INFORMATION_ODOMETRY, poses[k], information)
    np.testing.assert_allclose(factors.of_latest(4), filled(informations).of_latest(4), rtol=1e-9, atol=1e-15)


STRAIGHT = np.array([0.3, 0.0, 0.0])


def grown(information: FloatArray, n_maps: int = 6, n_overlap: int = 8, n_full: int = 15) -> FloatArray:
    """(maps, n_overlap, 3, 3) covariances on each change of map, along a straight path."""
    factors, poses = LocalFactors(), poses_of(n_full + 7 * n_maps, STRAIGHT)
    factors.start(poses[0])
    covs: list[FloatArray] = []
    last = n_full - 1
    for k in range(1, len(poses)):
        factors.add(STRAIGHT, INFORMATION_ODOMETRY, poses[k], information)
        if k == last and len(covs) < n_maps:
            covs.append(factors.of_latest(n_overlap))
            last += n_full - n_overlap
    return np.array(covs)


def test_along_a_corridor_errors_grow_with_the_odometry() -> None:
    covs = grown(np.diag([0.0, 1e5, 4e6]))
    for of_map in covs:
        np.testing.assert_allclose(of_map[:, 0, 0], COV_ODOMETRY[0, 0] * np.arange(8), rtol=0.02, atol=1e-9)
        assert of_map[:, 1, 1].max() < 4e-5
        assert of_map[:, 2, 2].max() < 1e-6


def test_in_a_room_errors_do_not_grow_from_map_to_map() -> None:
    std = np.array([0.004, 0.003, 0.001])
    covs = grown(np.diag(std**-2.0))
    for of_map in covs[1:]:
        # of two matches: the anchor's and the keyframe's
        assert (np.sqrt(of_map[-1].diagonal()) < 1.5 * np.hypot(std, [0, 2.1 * std[2], 0])).all()
        np.testing.assert_allclose(of_map, covs[1], rtol=1e-3, atol=1e-12)


def test_covariances_are_symmetric_and_positive(rng: np.random.Generator) -> None:
    covs = filled([random_information(rng) for _ in range(7)]).of_latest(7)
    np.testing.assert_array_equal(covs, np.swapaxes(covs, 1, 2))
    assert (np.linalg.eigvalsh(covs[1:]) > 0.0).all()
