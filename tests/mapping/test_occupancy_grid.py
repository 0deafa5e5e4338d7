import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping._grid_kernels import FROM_LASER
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid

Cell = tuple[int, int]


def logit(p: float) -> float:
    return math.log(p / (1.0 - p))


class PlainGrid:
    """The grid as a dict: (row, col) -> log-odds, scan that touched it last."""

    def __init__(self, config: GridConfig) -> None:
        self.config = config
        self.cells: dict[Cell, tuple[float, int]] = {}
        self.oldest = 0

    def cell(self, point: FloatArray) -> Cell:
        return math.floor(point[1] / self.config.resolution_m), math.floor(
            point[0] / self.config.resolution_m
        )

    def crossed(self, origin: FloatArray, end: FloatArray) -> set[Cell]:
        """Cells under one sample per cell of the longer axis, from the origin up to the end point's cell."""
        a, step = origin / self.config.resolution_m, (end - origin) / self.config.resolution_m
        samples = a + step / np.abs(step).max() * np.arange(int(np.abs(step).max()) + 1)[:, None]
        cells = [(math.floor(y), math.floor(x)) for x, y in samples]
        return set(cells[: cells.index(self.cell(end))] if self.cell(end) in cells else cells)

    def update(
        self,
        now: int,
        origin: FloatArray,
        ends: FloatArray,
        is_beam: BoolArray,
        is_hit: BoolArray,
        is_soft_hit: BoolArray,
    ) -> None:
        """`origin` is (2,), or (n, 2) where each beam has its own."""
        origins = np.broadcast_to(origin, ends.shape)
        c = self.config
        hits = {self.cell(end) for end in ends[is_hit]}
        soft = {self.cell(end) for end in ends[is_soft_hit]} - hits
        beams = zip(origins[is_beam], ends[is_beam], strict=True)
        passes = set().union(*(self.crossed(*beam) for beam in beams)) - hits - soft
        for cells, p in ((hits, c.p_hit), (soft, c.p_soft_hit), (passes, c.p_pass)):
            for cell in cells:
                value, stamp = self.cells.get(cell, (0.0, -1))
                value = (value if stamp >= self.oldest else 0.0) + logit(p)
                self.cells[cell] = min(max(value, logit(c.p_min)), logit(c.p_max)), now

    def log_odds(self) -> dict[Cell, float]:
        return {cell: value for cell, (value, stamp) in self.cells.items() if stamp >= self.oldest}


def centres(cells: list[Cell], resolution_m: float) -> FloatArray:
    return (np.array(cells, dtype=np.float64)[:, ::-1] + 0.5) * resolution_m


def assert_equal_around(
    grid: OccupancyGrid, plain: PlainGrid, origin: FloatArray, half: int, n_corners: int = 0
) -> None:
    row, col = plain.cell(origin)
    cells = [(row + i, col + j) for i in range(-half, half) for j in range(-half, half)]
    value = plain.log_odds()
    expected = 1.0 / (1.0 + np.exp(-np.array([value.get(cell, 0.0) for cell in cells])))
    found = grid.probability(centres(cells, plain.config.resolution_m))
    # a beam through the corner of a cell goes by one side or by the other
    n_other = np.count_nonzero(np.abs(found - expected) > 1e-6)
    assert n_other <= n_corners


def random_scan(
    rng: np.random.Generator, origin: FloatArray, reach_m: float, n: int = 25
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, BoolArray]:
    """Origin, end points, beams, hits and soft hits; few beams have a return, so that none leaves cells to another."""
    n *= FROM_LASER
    angles = rng.uniform(-np.pi, np.pi, n)
    ends = origin + rng.uniform(0.15, reach_m, (n, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    is_beam, kind = np.arange(n) % FROM_LASER == 0, rng.random(n)
    ends[~is_beam] = np.nan
    return origin, ends, is_beam, is_beam & (kind < 0.5), is_beam & (kind > 0.7)


@settings(max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([None, 6.0]),
    st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
    st.floats(0.01, 1.0),
)
def test_a_crop_holds_the_cells_that_its_square_touches(
    seed: int,
    window_m: float | None,
    start: tuple[float, float],
    offset: tuple[float, float],
    half_side: float,
) -> None:
    """Across the rolling storage's edges (6.4 m apart) and a fixed one's, which ends within 13 m of what was seen."""
    rng, config = np.random.default_rng(seed), GridConfig(resolution_m=0.1)
    grid, plain = OccupancyGrid(config, window_m=window_m), PlainGrid(config)
    origin = np.array(start) if window_m is not None else 0.1 * np.array(start)
    for now in range(6):
        origin = origin + rng.normal(0.0, 0.15, 2)
        grid.oldest = plain.oldest = max(0, now - 3) if window_m is not None else 0
        scan = random_scan(rng, origin, 1.0)
        grid.update(now, *scan)
        plain.update(now, *scan)
    reach_m = 1.0 if window_m is not None else 14.0
    centre, half_side_m = origin + reach_m * np.array(offset), 2.0 * reach_m * half_side
    crop = grid.crop(centre, half_side_m)
    corner = np.round(crop.origin * 10.0).astype(int)
    np.testing.assert_allclose(crop.origin, 0.1 * corner, atol=1e-9)
    upper = crop.origin + 0.1 * np.array(crop.p_occupied.shape[::-1])
    for low, side in ((crop.origin, centre - half_side_m), (upper - 0.1, centre + half_side_m)):
        assert (low <= side + 1e-9).all()
        assert (side <= low + 0.1 + 1e-9).all()
    value = plain.log_odds()
    expected = [
        [value.get((corner[1] + i, corner[0] + j), np.nan) for j in range(crop.p_occupied.shape[1])]
        for i in range(crop.p_occupied.shape[0])
    ]
    np.testing.assert_allclose(crop.p_occupied, 1.0 / (1.0 + np.exp(-np.array(expected))), atol=1e-6)


@pytest.mark.parametrize("window_m", [None, 6.0])
def test_grid_equals_a_plain_one_over_a_drive(rng: np.random.Generator, window_m: float | None) -> None:
    config = GridConfig(resolution_m=0.1)
    grid, plain = OccupancyGrid(config, window_m=window_m), PlainGrid(config)
    origin = np.array([-0.33, 0.21])
    for now in range(40):  # 8 m in all, farther than the rolling grid's side
        origin = origin + rng.normal([0.2, -0.1], 0.02)
        grid.oldest = plain.oldest = max(0, now - 5)
        scan = random_scan(rng, origin, 1.2)
        grid.update(now, *scan)
        plain.update(now, *scan)
        assert_equal_around(grid, plain, origin, 25)
    assert len(plain.log_odds()) > 200


def test_fixed_grid_never_forgets_while_it_grows(rng: np.random.Generator) -> None:
    config = GridConfig(resolution_m=0.1)
    grid, plain = OccupancyGrid(config), PlainGrid(config)
    small = grid.log_odds.shape
    for now, x in enumerate([0.0, 9.0, -30.0, 3.0, 0.1]):
        scan = random_scan(rng, np.array([x, -x]), 3.0)
        grid.update(now, *scan)
        plain.update(now, *scan)
    assert grid.log_odds.size > np.prod(small)
    for x in (0.0, 9.0, -30.0, 3.0):
        assert_equal_around(grid, plain, np.array([x, -x]), 32)


def test_beam_frees_the_cells_before_its_end_and_occupies_that() -> None:
    grid = OccupancyGrid(GridConfig(resolution_m=0.1))
    grid.update(0, np.array([0.05, 0.05]), np.array([[0.55, 0.05]]), np.array([True]), np.array([True]))
    p = grid.probability(centres([(0, j) for j in range(-1, 8)], 0.1))
    np.testing.assert_allclose(p, [0.5, 0.4, 0.4, 0.4, 0.4, 0.4, 0.7, 0.5, 0.5], atol=1e-6)
    assert np.all(grid.probability(centres([(1, 2), (-1, 2)], 0.1)) == 0.5)


@pytest.mark.parametrize(
    ("is_soft_hit", "p"), [(None, 0.6), (np.array([True]), 0.6), (np.array([False]), 0.5)]
)
def test_a_moving_point_frees_its_beam_and_hardly_fills_its_cell(
    is_soft_hit: BoolArray | None, p: float
) -> None:
    grid = OccupancyGrid(GridConfig(resolution_m=0.1, p_soft_hit=0.6))
    beam = np.array([0.05, 0.05]), np.array([[0.05, 0.45]]), np.array([True]), np.array([False])
    grid.update(0, *beam, is_soft_hit)
    np.testing.assert_allclose(grid.probability(centres([(2, 0), (4, 0)], 0.1)), [0.4, p], atol=1e-6)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_each_cell_counts_once_a_scan_and_a_hit_wins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    once, thrice = OccupancyGrid(GridConfig()), OccupancyGrid(GridConfig())
    origin, ends, is_beam, is_hit, _ = random_scan(rng, rng.normal(size=2), 2.0, n=16)
    none = np.zeros(len(ends), dtype=bool)
    once.update(0, origin, ends, is_beam, is_hit, none)
    blocks = np.arange(len(ends)).reshape(16, -1)
    order = np.concatenate([blocks, np.roll(blocks, 4, axis=0), np.roll(blocks, 10, axis=0)]).ravel()
    thrice.update(0, origin, *(a[order] for a in (ends, is_beam, is_hit, none)))
    np.testing.assert_array_equal(once.log_odds, thrice.log_odds)
    np.testing.assert_allclose(once.probability(ends[is_hit]), 0.7, atol=1e-6)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_beams_does_not_matter(seed: int) -> None:
    rng, grids = np.random.default_rng(seed), [OccupancyGrid(GridConfig(resolution_m=0.2)) for _ in range(2)]
    for now in range(4):
        # so near that hits and soft hits share cells
        origin, *beams = random_scan(rng, rng.normal(size=2), 1.0, n=20)
        order = rng.permutation(np.arange(len(beams[0])).reshape(20, -1)).ravel()
        for grid, arrays in zip(grids, (beams, [a[order] for a in beams]), strict=True):
            grid.update(now, origin, *arrays)
    np.testing.assert_array_equal(grids[0].log_odds, grids[1].log_odds)


@pytest.mark.parametrize("step_deg", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("fill_gaps", [False, True])
@given(st.integers(0, 2**32 - 1))
@settings(
    max_examples=10, derandomize=True
)  # the share of cells left out has a tail: the same seeds each time
def test_beams_closer_than_cells_free_what_each_alone_would(
    step_deg: float, fill_gaps: bool, seed: int
) -> None:
    """In a room with corners and things in it; single cells may be left out, where lines cross the diagonal."""
    rng = np.random.default_rng(seed)
    angles = np.radians(np.arange(0.0, 270.0, step_deg))
    u = np.column_stack([np.cos(angles), np.sin(angles)])
    walls = rng.uniform(2.0, 9.0, (4, 1)) / np.maximum(np.vstack([u.T, -u.T]), 1e-9)
    ranges = np.minimum(walls.min(axis=0), 9.0) + rng.normal(0.0, 0.01, len(u))
    for place in rng.integers(0, len(u) - 8, 5):
        ranges[place : place + 8] = np.minimum(ranges[place : place + 8], rng.uniform(0.5, 6.0))
    ranges[rng.random(len(u)) < 0.02] = np.nan
    is_hit = np.isfinite(ranges)
    origin = rng.normal(size=2)
    ends = origin + ranges[:, None] * u
    config = GridConfig(resolution_m=0.1, fill_gaps=fill_gaps)
    grid, plain = OccupancyGrid(config), PlainGrid(config)
    grid.update(0, origin, ends, is_hit, is_hit)
    plain.update(0, origin, ends, is_hit, is_hit, np.zeros(len(u), dtype=bool))
    cells = list(plain.log_odds())
    p = grid.probability(centres(cells, 0.1))
    left_out = [cell for cell, value in zip(cells, p, strict=True) if value == 0.5]
    assert len(left_out) < 0.005 * len(cells)
    beside = [(i + di, j + dj) for i, j in left_out for di, dj in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    if left_out:
        n_seen_beside = (grid.probability(centres(beside, 0.1)) != 0.5).reshape(-1, 4).sum(axis=1)
        assert np.all(n_seen_beside >= 2)
    if not fill_gaps:
        assert int((grid.log_odds != 0.0).sum()) == len(cells) - len(left_out)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_a_hit_wins_over_a_soft_hit_in_its_cell(order: list[int]) -> None:
    grid = OccupancyGrid(GridConfig(resolution_m=0.1))
    ends, is_hit = np.array([[1.02, 0.02], [1.08, 0.08]])[order], np.array([True, False])[order]
    grid.update(0, np.zeros(2), ends, np.ones(2, dtype=bool), is_hit)
    np.testing.assert_allclose(grid.probability(ends), 0.7, atol=1e-6)


def test_beams_far_apart_leave_no_gap_between_them() -> None:
    grid, corner = OccupancyGrid(GridConfig(resolution_m=0.05)), 8.0 * np.array([1.0, np.tan(0.04)])
    ends = np.array([[8.0, 0.0], corner])
    grid.update(0, np.zeros(2), ends, np.array([True, True]), np.array([True, True]))
    p = grid.to_map()
    rows, cols = np.indices(p.p_occupied.shape)
    x, y = p.origin[:, None] + 0.05 * (np.array([cols.ravel(), rows.ravel()]) + 0.5)
    is_free = np.nan_to_num(p.p_occupied.ravel(), nan=0.5) < 0.5
    inside = (y > 0.05) & (y < x * np.tan(0.04) - 0.05) & (x < 7.8)
    outside = (y < -0.05) | (y > x * np.tan(0.04) + 0.1)
    assert inside.sum() > 100
    assert is_free[inside].all()
    assert not is_free[outside].any()


def test_probabilities_stay_within_their_bounds() -> None:
    grid = OccupancyGrid(GridConfig(p_min=0.1, p_max=0.9))
    for now in range(30):
        grid.update(now, np.array([0.0, 0.0]), np.array([[1.0, 0.0]]), np.array([True]), np.array([True]))
    np.testing.assert_allclose(grid.probability(np.array([[0.5, 0.0], [1.0, 0.0]])), [0.1, 0.9], atol=1e-6)


def test_expired_cells_count_as_never_seen() -> None:
    grid = OccupancyGrid(GridConfig(), window_m=8.0)
    beam = np.array([0.0, 0.0]), np.array([[1.02, 0.02]]), np.array([True]), np.array([True])
    for now in range(5):
        grid.update(now, *beam)
    assert grid.probability(beam[1])[0] > 0.95
    grid.oldest = 5
    assert grid.probability(beam[1])[0] == 0.5
    grid.update(5, *beam)
    assert grid.probability(beam[1])[0] == pytest.approx(0.7, abs=1e-6)


def test_no_beams_change_nothing() -> None:
    grid = OccupancyGrid(GridConfig())
    nan = np.full((3, 2), np.nan)
    grid.update(0, np.zeros(2), nan, np.zeros(3, dtype=bool), np.zeros(3, dtype=bool))
    assert not (grid.stamp >= 0).any()
    assert np.isnan(grid.to_map().p_occupied).all()


def test_map_is_cropped_with_its_lower_left_corner() -> None:
    grid = OccupancyGrid(GridConfig(resolution_m=0.1))
    hits = np.array([[-1.05, 2.05], [0.25, 2.35]])
    grid.update(0, np.array([0.25, 2.05]), hits, np.array([False, True]), np.array([True, True]))
    rendered = grid.to_map()
    assert rendered.p_occupied.shape == (4, 14)
    np.testing.assert_allclose(rendered.origin, [-1.1, 2.0], atol=1e-9)
    assert rendered.resolution_m == 0.1
    # row 0 is the lowest y
    np.testing.assert_allclose(rendered.p_occupied[[0, 3], [0, 13]], 0.7, atol=1e-6)
    np.testing.assert_allclose(rendered.p_occupied[:3, 13], 0.4, atol=1e-6)
    assert np.isnan(rendered.p_occupied).sum() == 4 * 14 - 5


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"resolution_m": 0.0}, "GridConfig.resolution_m must be positive, not 0.0"),
        ({"resolution_m": math.nan}, "GridConfig.resolution_m must be positive, not nan"),
        ({"p_hit": 0.5}, "GridConfig needs 0 < p_min < p_pass < 0.5 < p_hit < p_max < 1"),
        ({"p_pass": 0.6}, "GridConfig needs 0 < p_min < p_pass"),
        ({"p_max": 1.0}, "GridConfig needs 0 < p_min < p_pass"),
        ({"p_min": 0.0}, "GridConfig needs 0 < p_min < p_pass"),
        ({"p_soft_hit": 0.4}, "GridConfig needs 0.5 <= p_soft_hit <= p_hit"),
        ({"p_soft_hit": 0.8}, "GridConfig needs 0.5 <= p_soft_hit <= p_hit"),
        ({"p_free": 0.02}, "GridConfig needs p_min < p_free < 0.5 < p_occupied < p_max"),
        ({"p_occupied": 0.98}, "GridConfig needs p_min < p_free < 0.5 < p_occupied < p_max"),
    ],
)
def test_impossible_grids_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        GridConfig(**changes)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 6.0]))
def test_each_beam_frees_the_cells_from_its_own_origin_on(seed: int, window_m: float | None) -> None:
    rng, config = np.random.default_rng(seed), GridConfig(resolution_m=0.1)
    grid, plain = OccupancyGrid(config, window_m=window_m), PlainGrid(config)
    start = rng.normal(0.0, 0.2, 2)
    for now in range(4):
        start = start + rng.normal(0.0, 0.1, 2)
        _, ends, is_beam, is_hit, is_soft_hit = random_scan(rng, start, 1.2)
        origins = start + np.linspace(-0.2, 0.2, len(ends))[:, None] * [1.0, 0.5]
        grid.update(now, origins, ends, is_beam, is_hit, is_soft_hit)
        plain.update(now, origins, ends, is_beam, is_hit, is_soft_hit)
    assert_equal_around(grid, plain, start, 25, n_corners=2)


def test_one_origin_for_all_beams_is_as_good_as_one_for_each(rng: np.random.Generator) -> None:
    once, each = (OccupancyGrid(GridConfig()) for _ in range(2))
    angles = np.linspace(-2.0, 2.0, 181)
    ends = 1.0 + rng.uniform(0.5, 6.0, (181, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    is_hit = rng.random(181) < 0.8
    once.update(0, np.ones(2), ends, is_hit, is_hit)
    each.update(0, np.ones((181, 2)), ends, is_hit, is_hit)
    np.testing.assert_array_equal(once.log_odds, each.log_odds)
