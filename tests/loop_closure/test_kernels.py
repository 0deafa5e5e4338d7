import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.loop_closure import _kernels

seeds = st.integers(0, 2**32 - 1)
CELL = 0.25
FAR = np.full(3, 1e9)


def pyramid_of(score: npt.NDArray[np.int16], n_levels: int) -> npt.NDArray[np.int16]:
    pyramid = np.empty((n_levels, *score.shape), dtype=np.int16)
    pyramid[0] = score
    for level in range(1, n_levels):
        _kernels.max_pool(pyramid[level - 1], 1 << (level - 1), pyramid[level])
    return pyramid


@settings(max_examples=40)
@given(seed=seeds, shape=st.tuples(st.integers(1, 20), st.integers(1, 20)), n_levels=st.integers(1, 5))
def test_each_level_holds_the_maximum_over_its_cells(
    seed: int, shape: tuple[int, int], n_levels: int
) -> None:
    score = np.random.default_rng(seed).integers(-9, 10, shape).astype(np.int16)
    for level, pooled in enumerate(pyramid_of(score, n_levels)):
        width = 1 << level
        # from a cell upwards, what is outside left out
        expected = maximum_filter(score, size=width, origin=-(width // 2), mode="constant", cval=-99)
        np.testing.assert_array_equal(pooled, expected)


def test_pooling_by_hand() -> None:
    score, out = np.array([[1, 5, 2], [0, 3, 9], [7, 4, 6]], dtype=np.int16), np.empty((3, 3), dtype=np.int16)
    _kernels.max_pool(score, 1, out)
    assert out.tolist() == [[5, 9, 9], [7, 9, 9], [7, 6, 6]]
    _kernels.max_pool(score, 2, out)
    assert out.tolist() == [[7, 5, 6], [9, 3, 9], [7, 4, 6]]


class Case:
    """A score grid with its margin, points, and a window to search."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.n_levels = int(rng.integers(1, 5))
        self.score = rng.choice([-2, 0, 0, 2, 4], rng.integers(5, 16, 2)).astype(np.int16)
        self.score = np.pad(self.score, 1 << (self.n_levels - 1))
        self.pyramid = pyramid_of(self.score, self.n_levels)
        self.origin = rng.uniform(-5.0, 5.0, 2)
        self.points = rng.uniform(-1.5, 1.5, (rng.integers(1, 12), 2))
        self.centre = np.array(
            [*(self.origin + CELL * np.array(self.score.shape[::-1]) / 2), rng.uniform(-4, 4)]
        )
        self.centre[:2] += rng.uniform(-1.0, 1.0, 2)
        self.n_cells, self.n_turns = int(rng.integers(0, 9)), int(rng.integers(0, 4))
        self.turn_step = float(rng.uniform(0.05, 0.4))

    def search(
        self, excluded: FloatArray = FAR, exclude_m: float = 0.5, exclude_rad: float = 0.1, min_score: int = 0
    ) -> tuple[int, FloatArray]:
        out = np.full(3, np.nan)
        best = _kernels.branch_and_bound(
            self.pyramid, self.origin[0], self.origin[1], 1.0 / CELL, self.points, self.centre,
            self.n_cells, self.n_turns, self.turn_step, excluded, exclude_m, exclude_rad, min_score, out,
        )  # fmt: skip
        return best, out

    def scores(self) -> tuple[FloatArray, IntArray]:
        """Every pose of the window (k, 3) and its score, each point looked up by itself."""
        steps = np.arange(-self.n_cells, self.n_cells + 1)
        turns = self.turn_step * np.arange(-self.n_turns, self.n_turns + 1)
        poses, values = [], []
        for turn in turns:
            at_centre = se2.transform(self.centre + np.array([0.0, 0.0, turn]), self.points)
            cells = np.floor((at_centre - self.origin) / CELL).astype(int)[:, ::-1]
            for i in steps:
                for j in steps:
                    moved = cells + np.array([i, j])
                    inside = ((moved >= 0) & (moved < self.score.shape)).all(axis=1)
                    values.append(int(self.score[tuple(moved[inside].T)].sum()))
                    poses.append(self.centre + np.array([j * CELL, i * CELL, turn]))
        return np.array(poses), np.array(values)


def is_near(poses: FloatArray, excluded: FloatArray, exclude_m: float, exclude_rad: float) -> BoolArray:
    apart = poses - excluded
    turned = np.abs((apart[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    return (np.hypot(apart[:, 0], apart[:, 1]) < exclude_m) & (turned < exclude_rad)


def score_of(poses: FloatArray, values: IntArray, found: FloatArray) -> int:
    k = int(np.argmin(np.abs(poses - found).sum(axis=1)))
    np.testing.assert_allclose(poses[k], found, atol=1e-9)
    return int(values[k])


@settings(max_examples=150)
@given(seeds)
def test_the_best_score_is_that_of_a_search_of_all_poses(seed: int) -> None:
    case = Case(seed)
    poses, values = case.scores()
    best, found = case.search()
    assert best == max(values.max(), 0)
    if best > 0:
        assert score_of(poses, values, found) == best
    else:
        assert np.isnan(found).all()


@settings(max_examples=100)
@given(seeds, st.floats(0.1, 1.5), st.floats(0.05, 1.0))
def test_poses_around_the_excluded_one_are_left_out(seed: int, exclude_m: float, exclude_rad: float) -> None:
    case = Case(seed)
    poses, values = case.scores()
    best = case.search()[1]
    excluded = case.centre if np.isnan(best).any() else best
    # a full turn on is the same pose
    excluded = excluded + np.array([0.001, -0.002, 2 * np.pi * (seed % 3 - 1) + 0.0003])
    second, found = case.search(excluded, exclude_m, exclude_rad)
    open_ = ~is_near(poses, excluded, exclude_m, exclude_rad)
    assert second == max(values[open_].max(initial=0), 0)
    if second > 0:
        assert score_of(poses[open_], values[open_], found) == second


@settings(max_examples=50)
@given(seeds)
def test_only_scores_above_the_least_one_count(seed: int) -> None:
    case = Case(seed)
    best, found = case.search()
    if best > 0:
        again, same = case.search(min_score=best - 1)
        assert again == best
        np.testing.assert_array_equal(same, found)
    none, out = case.search(min_score=best)
    assert none == 0
    assert np.isnan(out).all()


@pytest.mark.parametrize("moved", [[0.75, -1.0, 0.3], [0.0, 0.0, 0.0], [-2.0, 2.0, -0.6]])
def test_a_known_pose_is_found(moved: list[float]) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-3.0, 3.0, (60, 2))
    T = np.array(moved)
    score = np.zeros((80, 80), dtype=np.int16)
    i, j = np.floor((se2.transform(T, points) + 10.0) / CELL).astype(int).T[::-1]
    score[i, j] = 4
    out = np.empty(3)
    best = _kernels.branch_and_bound(
        pyramid_of(score, 5), -10.0, -10.0, 1.0 / CELL, points, np.zeros(3), 10, 8, 0.1, FAR, 0.5, 0.1, 0, out
    )  # fmt: skip
    assert best == 4 * 60
    np.testing.assert_allclose(out, T, atol=1e-9)
