"""The tiled grid against the grid that grows, and what it gives of an extent that no picture holds."""

from typing import Any

import numpy as np
import pytest

from slammot_graph.core.results import GridMap
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping._tile_kernels import bounds
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.mapping.tiled_grid import PartialMapError, TiledGrid

CONFIG = GridConfig(resolution_m=0.1)


def beams(rng: np.random.Generator, origin: FloatArray, reach_m: float, n: int = 60) -> tuple[Any, ...]:
    """End points around a place, which of them free, hit, and hit softly."""
    ends = origin + rng.uniform(-reach_m, reach_m, (n, 2))
    is_beam = rng.random(n) < 0.8
    is_hit = is_beam & (rng.random(n) < 0.7)
    return ends, is_beam, is_hit, is_beam & ~is_hit


@pytest.mark.parametrize("seed", range(3))
def test_it_equals_a_grid_as_large_as_the_extent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tiled, whole = TiledGrid(CONFIG), OccupancyGrid(CONFIG)
    places = rng.uniform(-40.0, 40.0, (6, 2))
    for now in range(60):  # there and back again, once with a beam longer than the window
        origin = places[now % len(places)] + rng.normal(0.0, 1.0, 2)
        used = beams(rng, origin, 60.0 if now == 30 else 8.0)
        tiled.update(now, origin, *used)
        whole.update(now, origin, *used)
    given, expected = tiled.to_map(), whole.to_map()
    np.testing.assert_array_equal(given.p_occupied, expected.p_occupied)
    np.testing.assert_allclose(given.origin, expected.origin)


def test_bounds_are_those_of_the_plain_ones() -> None:
    rng = np.random.default_rng(5)
    for n, n_origins in ((0, 1), (1, 1), (50, 1), (50, 50)):
        origins = rng.normal(size=(n_origins, 2)) * 4.0
        ends, *masks = beams(rng, origins[0], 3.0, n)
        ends[~(masks[0] | masks[1] | masks[2])] = np.nan
        points = np.vstack([origins, ends[masks[0] | masks[1] | masks[2]]])
        np.testing.assert_array_equal(bounds(origins, ends, *masks), [*points.min(0), *points.max(0)])


def see(grid: TiledGrid, now: int, x: float, n: int = 5) -> None:
    origin = np.array([x, 0.0])
    ends = origin + np.array([[2.0, 0.2 * k] for k in range(n)])
    yes = np.full(n, True)
    grid.update(now, origin, ends, yes, yes, ~yes)


def test_after_a_leap_the_larger_part_is_given_and_the_leap_told() -> None:
    grid = TiledGrid(CONFIG)
    see(grid, 0, 0.0)
    see(grid, 1, 20_000.0, n=9)
    with pytest.raises(PartialMapError, match=r"spans 200\d\d x \d+ m.*look for a leap") as caught:
        grid.to_map(most_cells=1_000_000)
    given = caught.value.grid
    assert given.p_occupied.size < 10_000
    np.testing.assert_allclose(given.origin, [20_000.0, 0.0], atol=0.2)
    assert len(grid._tiles) < 10  # memory follows what was seen


def test_a_map_too_large_in_one_piece_gets_larger_cells() -> None:
    grid = TiledGrid(CONFIG)
    for k in range(80):
        see(grid, k, 0.5 * k)
    given = grid.to_map(most_cells=20 * 64 * 64 // 16)
    assert given.resolution_m == pytest.approx(0.4)
    fine = grid.to_map()
    rows, cols = np.nonzero(np.isfinite(fine.p_occupied))
    centres = fine.origin + fine.resolution_m * (np.column_stack([cols, rows]) + 0.5)
    i, j = np.floor((centres - given.origin)[:, ::-1] / given.resolution_m).astype(int).T
    most = np.full(given.p_occupied.shape, -1.0)
    np.maximum.at(most, (i, j), fine.p_occupied[rows, cols])
    np.testing.assert_array_equal(np.where(most < 0.0, np.nan, most), given.p_occupied)


def test_cells_around_a_path_are_free_unless_occupied() -> None:
    grid = TiledGrid(CONFIG)
    for now in range(5):
        see(grid, now, 0.0)
    before = grid.to_map()
    grid.free_around(np.array([[2.05, 0.05], [-5.0, -5.0]]), 0.2)
    after = grid.to_map()

    def p(grid_map: GridMap, x: float, y: float) -> float:
        row, col = np.floor((np.array([x, y]) - grid_map.origin)[::-1] / 0.1).astype(int)
        return float(grid_map.p_occupied[row, col])

    assert p(before, 2.05, 0.05) == p(after, 2.05, 0.05) > 0.8
    assert p(after, 2.15, 0.05) < 0.2
    assert p(after, -5.05, -5.05) < 0.2


def test_nothing_seen_is_an_unknown_cell() -> None:
    assert np.isnan(TiledGrid(CONFIG).to_map().p_occupied).all()


def test_evidence_of_a_cell_stays_within_its_bounds() -> None:
    grid = TiledGrid(CONFIG)
    for now in range(20):
        grid.add_evidence(now, np.array([3.0, 4.0]), -1.0)
    assert grid.to_map().p_occupied.item() == pytest.approx(CONFIG.p_min)
