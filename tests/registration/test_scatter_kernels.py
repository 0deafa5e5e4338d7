"""The scatter of a match against its plain NumPy twin."""

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.registration import _scatter_kernels
from tests.registration.keyframes import (
    CONFIG,
    A,
    circle,
    close,
    lines_of,
    local_map_of,
    pairs_of,
    random_cov,
    scatter_twin,
)
from tests.rooms import LASER, box, take_scan


def scatter(scan: Scan, local_map: LocalMap, T: FloatArray) -> tuple[FloatArray, ...]:
    white, common, inherited = np.empty((3, 3, 3))
    by_keyframe = np.empty((len(local_map.T_local_keyframes), 3, 3))
    _scatter_kernels.residual_scatter(
        local_map.points,
        local_map.normals,
        local_map.nearest,
        local_map.inv_cell,
        local_map.first,
        scan.points_base(),
        scan.is_valid(),
        LASER.origins_base,
        T,
        local_map.config.reach_m**2,
        CONFIG.kernel_scale_m**2,
        CONFIG.point_weight,
        CONFIG.line_gap_m,
        local_map.owner,
        local_map.T_local_keyframes,
        local_map.keyframe_roots,
        white,
        common,
        inherited,
        by_keyframe,
    )
    return white, common, inherited, by_keyframe


@pytest.mark.parametrize("seed", range(4))
def test_scatter_equals_its_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = circle(6)
    local_map = local_map_of(poses, rng, covs=np.array([random_cov(rng) for _ in poses]))
    local_map.normals[rng.choice(local_map.end, local_map.end // 5)] = 0.0  # foliage
    T = se2.compose(A, rng.normal(0.0, [0.05, 0.05, 0.03]))
    scan = take_scan(A, noise=rng.normal(0.0, 0.03, LASER.n_beams))
    pairs = pairs_of(scan, local_map, T)
    assert 10 < np.count_nonzero(~pairs.is_line) < len(pairs.rows) - 50
    for got, expected in zip(scatter(scan, local_map, T), scatter_twin(pairs, local_map, T), strict=True):
        close(got, expected)
        np.testing.assert_array_equal(got, np.swapaxes(got, -1, -2))


def test_pairs_on_one_wall_are_one_line() -> None:
    local_map = local_map_of(A[None], walls=box(-4, -4, 4, 4))
    scan = take_scan(A, walls=box(-4, -4, 4, 4))
    lines = lines_of(pairs_of(scan, local_map, A), local_map)
    assert 3 <= len([line for line in lines if len(line) > 5]) <= 4
    white, common, inherited, _ = scatter(scan, local_map, A)
    # on a line the common errors add up to many times those that are each pair's own
    assert np.linalg.eigvalsh(common)[-1] > 10.0 * np.linalg.eigvalsh(white)[-1]
    np.testing.assert_array_equal(inherited, np.zeros((3, 3)))


@pytest.mark.parametrize("turns", [(0.0, 0.0), (0.0, np.pi), (0.3, 2.0), (-1.5, 1.5)])
def test_a_map_misplaced_as_a_whole_misplaces_the_match(turns: tuple[float, float]) -> None:
    """However the robot stood when it took the keyframes."""
    std = 0.02
    poses = np.array([se2.compose(A, np.array([0.0, 0.0, turn])) for turn in turns])
    local_map = local_map_of(poses, covs=np.tile(np.diag([std**2, std**2, 0.0]), (2, 1, 1)))
    local_map.owner[: local_map.end] = np.arange(local_map.end) % 2  # as many points of each, side by side
    scan = take_scan(A)
    pairs = pairs_of(scan, local_map, A)
    inverse = np.linalg.inv(pairs.rows.T @ (pairs.weights[:, None] * pairs.rows))
    cov = inverse @ scatter(scan, local_map, A)[2] @ inverse
    np.testing.assert_allclose(cov, np.diag([std**2, std**2, 0.0]), atol=1e-9)
