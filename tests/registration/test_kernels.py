from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.mapping import _local_map_kernels
from slammot_graph.mapping._local_map_kernels import LINE_FIRST_M2
from slammot_graph.registration import _solve_kernels

seeds = st.integers(0, 2**32 - 1)
POINT_WEIGHT = 0.2
CELL = 0.0625  # a power of two: shifts by whole cells are exact
REACH_CELLS = 6


def unit(angle: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@dataclass
class Field:
    """A nearest-point field with few cells."""

    side: int = 64
    capacity: int = 256
    first: int = 0
    end: int = 0

    def __post_init__(self) -> None:
        self.points, self.normals = np.zeros((2, self.capacity, 2))
        self.nearest = np.full((self.side, self.side), -1, dtype=np.int32)

    def insert(self, points: FloatArray, normals: FloatArray, is_new: BoolArray | None = None) -> None:
        self.end = _local_map_kernels.insert_points(
            self.points,
            self.normals,
            self.nearest,
            1.0 / CELL,
            self.first,
            self.end,
            points,
            normals,
            np.ones(len(points), dtype=bool) if is_new is None else is_new,
            0.03,
            REACH_CELLS,
        )

    @property
    def kept(self) -> IntArray:
        return np.arange(self.first, self.end)

    def lookup(self, points: FloatArray) -> IntArray:
        i, j = np.floor(points[:, ::-1] / CELL).astype(int).T % self.side
        nearest: IntArray = self.nearest[i, j]
        return nearest


def cell_centres(half_m: float) -> FloatArray:
    steps = np.arange(-half_m, half_m, CELL) + CELL / 2
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


@settings(max_examples=20)
@given(seeds)
def test_field_holds_the_true_nearest_of_points_on_lines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = Field()
    for _ in range(3):
        field.insert(rng.uniform(-1.5, 1.5, (8, 2)), unit(rng.uniform(0, np.pi, 8)))
    centres = cell_centres(1.5)
    distance, number = map(np.asarray, cKDTree(field.points[field.kept]).query(centres))
    within = distance <= REACH_CELLS * CELL
    stored = field.lookup(centres)
    assert (stored[within] >= 0).all()
    np.testing.assert_allclose(
        np.linalg.norm(field.points[stored[within]] - centres[within], axis=1), distance[within], atol=1e-12
    )
    assert (stored[within] == number[within]).mean() > 0.99  # but for ties


@settings(max_examples=20)
@given(seeds)
def test_field_equals_a_search_of_all_points_with_the_handicap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = Field()
    normals = unit(rng.uniform(0, np.pi, 20)) * (rng.random((20, 1)) < 0.5)
    field.insert(rng.uniform(-1.5, 1.5, (20, 2)), normals)
    points, centres = field.points[field.kept], cell_centres(1.9375)
    cost = np.sum((centres[:, None] - points[None]) ** 2, axis=-1)
    cost += LINE_FIRST_M2 * ~field.normals[field.kept].any(axis=1)
    cells_apart = np.abs(np.floor(centres[:, None] / CELL) - np.floor(points[None] / CELL)).max(axis=-1)
    cost[cells_apart > REACH_CELLS] = np.inf
    stored = field.lookup(centres)
    np.testing.assert_array_equal(stored >= 0, np.isfinite(cost.min(axis=1)))
    reached = stored >= 0
    np.testing.assert_allclose(cost[reached, stored[reached]], cost[reached].min(axis=1), rtol=0, atol=1e-12)


def test_a_like_point_close_by_is_left_out_and_a_corner_is_kept() -> None:
    field = Field()
    at, up, left = np.array([[0.03, 0.03]]), np.array([[0.0, 1.0]]), np.array([[1.0, 0.0]])
    near = np.array([0.01, 0.0])
    field.insert(at, up)
    field.insert(at + near, up)
    field.insert(at + near, 0.0 * up)
    assert field.end == 1
    field.insert(at + near, left)
    assert field.end == 2
    field.insert(at + 3.1 * near, up)
    assert field.end == 3


def test_the_other_side_of_a_thin_wall_is_a_point_of_its_own() -> None:
    field = Field()
    at, up = np.array([[0.03, 0.03]]), np.array([[0.0, 1.0]])
    field.insert(at, up)
    field.insert(at - [0.0, 0.01], -up)
    assert field.end == 2


def test_points_that_are_not_new_are_not_taken() -> None:
    field = Field()
    points = np.column_stack([[0.0, 0.2, 0.4]] * 2)
    field.insert(points, np.ones((3, 2)), np.array([False, True, False]))
    np.testing.assert_allclose(field.points[: field.end], [[0.2, 0.2]])


def test_field_repeats_itself_after_its_side(rng: np.random.Generator) -> None:
    here, there = Field(), Field()
    points, normals = rng.uniform(-1.5, 1.5, (20, 2)), unit(rng.uniform(0, np.pi, 20))
    here.insert(points, normals)
    there.insert(points + CELL * np.array([64, -128]), normals)
    np.testing.assert_array_equal(here.nearest, there.nearest)


def test_numbers_below_first_belong_to_an_earlier_map(rng: np.random.Generator) -> None:
    field, alone = Field(), Field()
    field.insert(rng.uniform(-1.5, 1.5, (20, 2)), unit(rng.uniform(0, np.pi, 20)))
    field.first = field.end
    points, normals = rng.uniform(-1.5, 1.5, (9, 2)), unit(rng.uniform(0, np.pi, 9))
    field.insert(points, normals)
    alone.insert(points, normals)
    stored = np.where(field.nearest >= field.first, field.nearest - field.first, -1)
    np.testing.assert_array_equal(stored, alone.nearest)


def test_a_full_ring_takes_no_more_until_the_next_map() -> None:
    field = Field(capacity=4)
    points = np.column_stack([np.arange(6) * 0.2, np.zeros(6)])
    field.insert(points, np.tile([0.0, 1.0], (6, 1)))
    assert field.end == 4
    np.testing.assert_allclose(field.points, points[:4])
    field.first = field.end
    field.insert(points[4:], np.tile([0.0, 1.0], (2, 1)))
    assert field.end == 6
    np.testing.assert_allclose(field.points[field.kept % 4], points[4:])


@settings(max_examples=50)
@given(seeds)
def test_solve3_agrees_with_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) * rng.choice([0.1, 1.0, 10.0], 3)[:, None]
    h, g, out = root @ root.T + 1e-3 * np.eye(3), rng.normal(size=3), np.empty(3)
    assert _solve_kernels.solve3(h, g, out)
    np.testing.assert_allclose(h @ out, g, atol=1e-6)
    np.testing.assert_allclose(out, np.linalg.solve(h, g), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("diagonal", [[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0], [1.0, -1.0, 1.0]])
def test_solve3_refuses_what_is_not_definite(diagonal: list[float]) -> None:
    assert not _solve_kernels.solve3(np.diag(diagonal), np.ones(3), np.empty(3))
    assert not _solve_kernels.solve3(np.full((3, 3), np.nan), np.ones(3), np.empty(3))
    assert not _solve_kernels.solve3(np.ones((3, 3)), np.ones(3), np.empty(3))


def accumulated(
    field: Field, points: FloatArray, laser: FloatArray, T: FloatArray, scale: float = 0.1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    h, g, stats = np.empty((3, 3)), np.empty(3), np.empty(4)
    is_used = np.isfinite(points[:, 0])
    _solve_kernels.accumulate(
        field.points, field.normals, field.nearest, 1.0 / CELL, field.first, points, is_used, laser[None], T,
        0.4**2, scale**2, POINT_WEIGHT, h, g, stats,
    )  # fmt: skip
    return h, g, stats


@pytest.mark.parametrize("has_lines", [True, False])
def test_normal_equations_equal_numeric_derivatives(rng: np.random.Generator, has_lines: bool) -> None:
    field = Field()
    normals = unit(rng.uniform(0, np.pi, 25)) * has_lines
    field.insert(rng.uniform(-1.5, 1.5, (25, 2)), normals)
    T, scale, laser = np.array([0.2, -0.1, 2.2]), 0.1, np.array([0.5, 0.3])
    points = se2.transform(se2.inverse(T), rng.uniform(-1.5, 1.5, (40, 2)))
    points[3] = np.nan
    h, g, stats = accumulated(field, points, laser, T, scale)

    at_T = se2.transform(T, points)
    number = np.where(np.isfinite(at_T[:, 0]), field.lookup(np.nan_to_num(at_T)), -1)
    is_pair = number >= 0
    is_pair[is_pair] = np.linalg.norm(field.points[number] - at_T, axis=1)[is_pair] <= 0.4
    to_laser = se2.transform(T, laser[None]) - field.points[number]
    is_pair &= np.sum(to_laser * field.normals[number], axis=1) >= 0.0  # it sees the face, not the back
    assert is_pair.sum() < 0.8 * (number >= 0).sum() or not has_lines
    partner = number[is_pair]

    def residuals(v: FloatArray) -> FloatArray:
        """(pairs, rows) with the pairs held fast."""
        moved = se2.transform(se2.compose(T, se2.exp(v)), points[is_pair])
        offset = moved - field.points[partner]
        return np.sum(offset * field.normals[partner], axis=1)[:, None] if has_lines else offset

    def cost(v: FloatArray) -> float:
        r2 = np.sum(residuals(v) ** 2, axis=1)
        return float(np.sum(scale**2 * r2 / (2.0 * (scale**2 + r2))))

    eps = 1e-6 * np.eye(3)
    J = np.stack([(residuals(e) - residuals(-e)) / 2e-6 for e in eps], axis=-1)
    weight = (scale**2 / (scale**2 + np.sum(residuals(np.zeros(3)) ** 2, axis=1))) ** 2
    share = 1.0 if has_lines else POINT_WEIGHT
    np.testing.assert_allclose(h, share * np.einsum("k,kri,krj->ij", weight, J, J), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(g, share * np.array([cost(e) - cost(-e) for e in eps]) / 2e-6, atol=1e-6)
    r2 = np.sum(residuals(np.zeros(3)) ** 2, axis=1)
    np.testing.assert_allclose(stats, [39, is_pair.sum(), weight.sum(), share * weight @ r2], rtol=1e-9)
    assert is_pair.sum() > 10


def test_no_partners_give_empty_normal_equations() -> None:
    h, g, stats = accumulated(Field(), np.ones((4, 2)), np.zeros(2), np.zeros(3))
    assert not h.any() and not g.any()
    assert stats.tolist() == [4.0, 0.0, 0.0, 0.0]
