"""Normals of a scan's points, against a plain twin and where walls are near, grazed or end."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping import _local_map_kernels
from slammot_graph.mapping._local_map_kernels import LEAST_TOLD, N_SIGMA, NOISE_REACH_M

seeds = st.integers(0, 2**32 - 1)


def unit(angle: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def plain_grazed_normal(points: FloatArray, is_member: BoolArray, k: int, thickness: float) -> FloatArray:
    """The normal of the chord from beam k - 1 to k + 1, where k lies between the two and near it."""
    if not (0 < k < len(points) - 1 and is_member[[k - 1, k + 1]].all()):
        return np.zeros(2)
    before, after, chord = points[k] - points[k - 1], points[k + 1] - points[k], points[k + 1] - points[k - 1]
    short, long = sorted(np.linalg.norm([before, after], axis=1))
    normal = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
    is_between = before @ after > 0.0 and long <= 4.0 * short
    return normal if is_between and abs(before @ normal) <= 2.0 * thickness else np.zeros(2)


def plain_line(points: FloatArray) -> tuple[FloatArray, float, float]:
    """Normal of a line through points, and the squares of their distances across and along it, summed up."""
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0))
    return axes[1], sizes[1] ** 2, sizes[0] ** 2


@dataclass
class PlainNormals:
    """The normals of all beams, by walking to both sides and singular value decompositions."""

    points: FloatArray
    is_member: BoolArray
    half: int
    gap: float
    slope: float
    thickness: float
    std: float

    def goes_on(self, k: int, m: int, side: int) -> bool:
        reach = self.gap + self.slope * np.linalg.norm(self.points[k])
        is_inside = 0 <= m + side < len(self.points) and self.is_member[m + side]
        return bool(is_inside and np.linalg.norm(self.points[m + side] - self.points[m]) <= reach)

    def window(self, k: int) -> tuple[int, int]:
        ends = [k, k]
        for i, side in enumerate((-1, 1)):
            while abs(ends[i] - k) < self.half and self.goes_on(k, ends[i], side):
                ends[i] += side
        return ends[0], ends[1]

    def noise2(self) -> float:
        variances = []
        for k in np.flatnonzero(self.is_member).tolist():
            ends = list(self.window(k))
            for i, side in enumerate((-1, 1)):
                while self.goes_on(k, ends[i], side):
                    if np.linalg.norm(self.points[ends[i] + side] - self.points[k]) > NOISE_REACH_M:
                        break
                    ends[i] += side
            count = ends[1] - ends[0] + 1
            if count < 4:
                continue
            normal, across, _ = plain_line(self.points[ends[0] : ends[1] + 1])
            cos2 = (normal @ self.points[k]) ** 2 / (self.points[k] @ self.points[k])
            if cos2 > LEAST_TOLD:
                variances.append(across / ((count - 2) * cos2))
        return float(min(np.median(variances), self.thickness**2)) if variances else 0.0

    def grown(self, k: int, low: int, high: int, noise2: float) -> FloatArray:
        normal, across, along = plain_line(self.points[low : high + 1])
        if across > (high - low + 1) * self.thickness**2:
            return np.zeros(2)
        own2 = max(noise2, across / (high - low - 1))
        grows = [True, True]
        while any(grows) and max(noise2, across / (high - low - 1)) > self.std**2 * along:
            for i, (end, side) in enumerate(((low, -1), (high, 1))):
                grows[i] = grows[i] and self.goes_on(k, end, side)
                if not grows[i]:
                    continue
                first, last = (low - 1, high) if i == 0 else (low, high + 1)
                wider = plain_line(self.points[first : last + 1])
                dof = last - first - 1
                grows[i] = wider[1] <= own2 * (dof + N_SIGMA * np.sqrt(2.0 * dof))
                grows[i] = grows[i] and wider[1] <= (dof + 2) * self.thickness**2
                if grows[i]:
                    low, high, (normal, across, along) = first, last, wider
        return normal

    def of_all(self) -> FloatArray:
        noise2, out = self.noise2(), np.zeros_like(self.points)
        for k in np.flatnonzero(self.is_member).tolist():
            low, high = self.window(k)
            is_alone = high - low < 2
            args = (self.points, self.is_member, k, self.thickness)
            out[k] = plain_grazed_normal(*args) if is_alone else self.grown(k, low, high, noise2)
        return out


@settings(max_examples=30)
@given(seeds, st.sampled_from([0.02, 0.1, 10.0]))
def test_normals_are_those_of_a_singular_value_decomposition(seed: int, std: float) -> None:
    rng = np.random.default_rng(seed)
    corners = np.cumsum(rng.uniform(-2.0, 2.0, (4, 2)), axis=0)
    along = np.linspace(0.0, 2.999, 40)[:, None]
    i = along[:, 0].astype(int)
    points = corners[i] + (along - i[:, None]) * (corners[i + 1] - corners[i]) + rng.normal(0, 0.02, (40, 2))
    is_member = rng.random(40) < 0.9
    laser, out = rng.uniform(-2.0, 2.0, 2), np.empty((40, 2))
    _local_map_kernels.estimate_normals(points, is_member, laser, 3, 0.15, 0.02, 0.03, std, out)
    expected = PlainNormals(points, is_member, 3, 0.15, 0.02, 0.03, std).of_all()
    np.testing.assert_array_equal(out.any(axis=1), expected.any(axis=1))
    has_normal = out.any(axis=1)
    np.testing.assert_allclose(np.abs(np.sum(out * expected, axis=1))[has_normal], 1.0, atol=1e-9)
    assert (np.sum(out * (laser - points), axis=1) >= 0.0).all()


def test_normals_of_a_wall_with_a_gap_and_of_a_lone_point() -> None:
    points = np.array([[x, 2.0] for x in (0.0, 0.1, 0.2, 1.0, 1.1, 1.2, 5.0)])
    out = np.empty_like(points)
    for side in (-1.0, 1.0):
        laser = np.array([0.3, 2.0 + side])
        _local_map_kernels.estimate_normals(
            points, np.ones(7, dtype=bool), laser, 3, 0.2, 0.0, 0.01, 0.05, out
        )
        np.testing.assert_allclose(out, [[0.0, side]] * 6 + [[0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize("step_m", [0.0, 0.025])
def test_beams_of_a_wall_close_by_have_its_normal(step_m: float) -> None:
    """A corridor of 2 m: noise of 2 cm, or steps of the ranges, on beams that hit the wall 1.7 cm apart."""
    angles, rng = np.deg2rad(np.arange(-89.5, 90.0)), np.random.default_rng(0)
    directions, squares = unit(angles), []
    for _ in range(20):
        ranges = 1.0 / np.abs(np.sin(angles)) + rng.normal(0.0, 0.02, len(angles))
        ranges = np.round(ranges / step_m) * step_m if step_m else ranges
        points, is_member = ranges[:, None] * directions, ranges < 20.0
        out = np.empty_like(points)
        _local_map_kernels.estimate_normals(points, is_member, np.zeros(2), 3, 0.4, 0.05, 0.04, 0.05, out)
        squares.append(np.sum(out[is_member, 0] ** 2))
    # what a match takes for information along the corridor, in pairs: below that of a weak direction, 1% of 180
    assert np.median(squares) < 0.5
    assert np.max(squares) < 1.8


def test_a_normal_does_not_reach_around_a_corner() -> None:
    angles, rng = np.deg2rad(np.arange(0.0, 91.0)), np.random.default_rng(0)
    ranges = 1.0 / np.maximum(np.cos(angles), np.sin(angles)) + rng.normal(0.0, 0.01, len(angles))
    points = ranges[:, None] * unit(angles)
    out = np.empty_like(points)
    _local_map_kernels.estimate_normals(
        points, np.ones(91, dtype=bool), np.zeros(2), 3, 0.4, 0.05, 0.04, 0.05, out
    )
    is_near = np.abs(np.arange(91) - 45) <= 6
    expected = np.where(np.arange(91)[:, None] < 45, [-1.0, 0.0], [0.0, -1.0])
    assert (np.sum(out * expected, axis=1)[~is_near] > np.cos(0.2)).all()


def test_points_on_a_grazed_wall_have_its_normal() -> None:
    angles = np.deg2rad(np.arange(80.0, 88.5, 1.0))  # 1 m to the right wall, 5.7 to 28.6 m ahead
    points = np.column_stack([1.0 / np.tan(np.pi / 2 - angles), np.full(len(angles), 1.0)])
    out = np.empty_like(points)
    _local_map_kernels.estimate_normals(
        points, np.ones(9, dtype=bool), np.zeros(2), 3, 0.2, 0.0, 0.02, 0.05, out
    )
    assert (np.diff(points[:, 0]) > 0.5).all()  # each alone within the gap
    np.testing.assert_allclose(out[1:-1], [[0.0, -1.0]] * 7, atol=1e-12)
    np.testing.assert_array_equal(out[[0, -1]], 0.0)  # there is but one neighbour


@pytest.mark.parametrize(
    ("middle", "has_normal"),
    [
        ([1.0, 0.0], True),
        ([0.45, 0.0], True),  # a step of four times the other
        ([0.38, 0.0], False),
        ([1.0, 0.079], True),  # twice the thickness off the line
        ([1.0, 0.081], False),
        ([-0.2, 0.0], False),  # not between the two
        ([2.2, 0.0], False),
    ],
)
def test_a_lone_point_has_a_normal_only_if_it_lies_between_its_neighbours(
    middle: list[float], has_normal: bool
) -> None:
    points, out = np.array([[0.0, 0.0], middle, [2.0, 0.0]]), np.empty((3, 2))
    for is_member in ([True, True, True], [True, True, False], [False, True, True]):
        mask = np.array(is_member)
        _local_map_kernels.estimate_normals(points, mask, np.array([1.0, -3.0]), 3, 0.1, 0.0, 0.04, 0.05, out)
        expected = [0.0, -1.0] if has_normal and mask.all() else [0.0, 0.0]
        np.testing.assert_allclose(out, [[0.0, 0.0], expected, [0.0, 0.0]], atol=1e-12)
