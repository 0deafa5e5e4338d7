"""Scans taken in by an occupancy grid: who occupies, who frees, and what beams without a return tell."""

import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping.occupancy_grid import GridConfig, NoReturnConfig, OccupancyGrid
from tests.rooms import LASER, ROOM, take_scan

T = np.array([1.0, 2.0, 0.3])
IS_MOVING: BoolArray = np.arange(LASER.n_beams) % 10 == 0


def grid_after(config: GridConfig, n_missing: int = 0) -> tuple[OccupancyGrid, FloatArray]:
    """A grid after one scan whose middle beams do not return, and the scan's points."""
    grid, scan = OccupancyGrid(config), take_scan(T, walls=ROOM)
    scan.ranges[90 : 90 + n_missing] = LASER.range_max
    points, is_valid = scan.points(T), scan.is_valid()
    grid.add_scan(0, scan, T, points, is_valid, is_valid & ~IS_MOVING)
    return grid, points


def test_moving_points_occupy_only_if_asked_for() -> None:
    quiet, points = grid_after(GridConfig())
    assert np.median(quiet.probability(points[IS_MOVING])) < 0.6
    np.testing.assert_allclose(np.median(quiet.probability(points[~IS_MOVING])), 0.7, atol=1e-6)
    ghostly, points = grid_after(GridConfig(occupy_with_moving=True))
    np.testing.assert_allclose(np.median(ghostly.probability(points[IS_MOVING])), 0.7, atol=1e-6)


@pytest.mark.parametrize(
    ("no_return", "n_missing", "is_freed"),
    [
        (None, 30, False),
        (NoReturnConfig(reach_m=1.0, min_run=25), 30, True),
        (NoReturnConfig(reach_m=1.0, min_run=25), 24, False),
        (NoReturnConfig(reach_m=0.4, min_run=25), 30, False),
    ],
)
def test_beams_without_a_return_free_what_is_near(
    no_return: NoReturnConfig | None, n_missing: int, is_freed: bool
) -> None:
    grid, _ = grid_after(GridConfig(no_return=no_return), n_missing)
    scan = take_scan(T)
    ahead = T[:2] + 0.7 * (scan.points(T)[102] - T[:2]) / scan.ranges[102]
    assert (grid.probability(ahead[None])[0] < 0.5) == is_freed


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"min_run": 0}, r"NoReturnConfig\.min_run must be at least 1, not 0"),
        ({"range_fraction": 0.0}, r"NoReturnConfig\.range_fraction must be in \(0, 1\], not 0.0"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        NoReturnConfig(**changes)  # type: ignore[arg-type]


def test_a_rolling_grid_takes_in_a_scan_as_a_fixed_one_does(rng: np.random.Generator) -> None:
    config = GridConfig(no_return=NoReturnConfig(reach_m=1.0, min_run=25))
    fixed, rolling = OccupancyGrid(config), OccupancyGrid(config, window_m=40.0)
    for k in range(3):
        T_k = T + rng.normal(0.0, 0.1, 3)
        scan = take_scan(T_k, walls=ROOM)
        scan.ranges[90:130] = LASER.range_max
        points, is_valid = scan.points(T_k), scan.is_valid()
        for grid in (fixed, rolling):
            grid.add_scan(k, scan, T_k, points, is_valid, is_valid & ~IS_MOVING)
    np.testing.assert_array_equal(
        fixed.crop(T[:2], 8.0).p_occupied, rolling.crop(T[:2], 8.0).p_occupied, strict=True
    )
    assert np.count_nonzero(fixed.crop(T[:2], 8.0).p_occupied < 0.5) > 500
