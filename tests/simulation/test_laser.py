from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.simulation.laser import (
    HIT_NOTHING,
    HIT_STATIC,
    LASERS,
    LMS200,
    SimulatedLaser,
    cast_rays,
    laser_named,
    measure,
)
from tests.rooms import ROOM

seeds = st.integers(0, 2**32 - 1)
NO_CIRCLES = np.empty((1, 0, 3))


def plain_cast(
    T_world_laser: FloatArray, model: LaserModel, segments: FloatArray, circles: FloatArray
) -> tuple[FloatArray, IntArray]:
    """One scan, every beam against every shape, in the world frame."""
    angles = T_world_laser[2] + model.angle_min + model.angle_increment * np.arange(model.n_beams)
    u = np.column_stack([np.cos(angles), np.sin(angles)])
    distances = np.full((model.n_beams, len(segments) + len(circles)), np.inf)
    for k, (x1, y1, x2, y2) in enumerate(segments):
        for b in range(model.n_beams):
            A = np.array([[u[b, 0], x1 - x2], [u[b, 1], y1 - y2]])
            if abs(np.linalg.det(A)) > 1e-12:
                r, share = np.linalg.solve(A, [x1 - T_world_laser[0], y1 - T_world_laser[1]])
                if r >= 0.0 and 0.0 <= share <= 1.0:
                    distances[b, k] = r
    for k, (x, y, radius) in enumerate(circles, start=len(segments)):
        if np.isnan(x):
            continue
        offset = T_world_laser[:2] - [x, y]
        for b in range(model.n_beams):
            roots = np.roots([1.0, 2.0 * u[b] @ offset, offset @ offset - radius**2])
            ahead = roots[np.isreal(roots) & (roots.real >= 0.0)].real
            if len(ahead):
                distances[b, k] = ahead.min()
    nearest = distances.argmin(axis=1)
    ranges = distances.min(axis=1)
    hits = np.where(nearest < len(segments), HIT_STATIC, nearest - len(segments))
    is_seen = ranges <= model.range_max
    return np.where(is_seen, ranges, np.inf), np.where(is_seen, hits, HIT_NOTHING)


@settings(max_examples=40)
@given(seeds)
def test_rays_equal_those_cast_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fov, n_beams = rng.uniform(0.3, 2 * np.pi), int(rng.integers(2, 40))
    model = LaserModel(
        angle_min=rng.uniform(-7.0, 7.0),
        angle_increment=rng.choice([-1.0, 1.0]) * fov / n_beams,
        n_beams=n_beams,
        range_min=0.0,
        range_max=rng.uniform(2.0, 12.0),
    )
    n, starts = 2, rng.uniform(-6.0, 6.0, (rng.integers(1, 7), 2))
    segments = np.hstack([starts, starts + rng.uniform(-5.0, 5.0, starts.shape)])
    circles = rng.uniform([-6, -6, 0.05], [6, 6, 2.5], (n, rng.integers(0, 4), 3))
    circles[rng.random(circles.shape[:2]) < 0.2] = np.nan
    T_world_laser = np.column_stack([rng.uniform(-4.0, 4.0, (n, 2)), rng.uniform(-9.0, 9.0, n)])
    ranges, hits = cast_rays(T_world_laser, model, segments, circles)
    for k in range(n):
        expected, expected_hits = plain_cast(T_world_laser[k], model, segments, circles[k])
        np.testing.assert_array_equal(hits[k], expected_hits)
        np.testing.assert_allclose(ranges[k], expected, rtol=1e-7, atol=1e-7)


def one_beam(
    segments: list[list[float]], circles: list[list[float]], angle: float = 0.0
) -> tuple[float, int]:
    model = LaserModel(angle_min=angle, angle_increment=0.1, n_beams=1, range_min=0.0, range_max=10.0)
    shapes = np.array(segments, dtype=float).reshape(-1, 4), np.array(circles, dtype=float).reshape(1, -1, 3)
    ranges, hits = cast_rays(np.zeros((1, 3)), model, *shapes)
    return float(ranges[0, 0]), int(hits[0, 0])


@pytest.mark.parametrize(
    ("segments", "circles", "expected"),
    [
        ([], [], (np.inf, HIT_NOTHING)),
        ([[2, -1, 2, 1]], [], (2.0, HIT_STATIC)),
        ([[2, 0, 2, 1]], [], (2.0, HIT_STATIC)),  # its very end
        ([[2, 0.001, 2, 1]], [], (np.inf, HIT_NOTHING)),
        ([[1, 0, 3, 0]], [], (np.inf, HIT_NOTHING)),  # edge on
        ([[-2, -1, -2, 1]], [], (np.inf, HIT_NOTHING)),  # behind
        ([[2, 0, 2, 0]], [], (np.inf, HIT_NOTHING)),  # no length
        ([[11, -1, 11, 1]], [], (np.inf, HIT_NOTHING)),
        ([], [[3, 0, 0.5]], (2.5, 0)),
        ([], [[0.1, 0, 0.5]], (0.6, 0)),  # from inside: its far side
        ([], [[-3, 0, 0.5]], (np.inf, HIT_NOTHING)),
        ([[2, -1, 2, 1]], [[3, 0, 0.5]], (2.0, HIT_STATIC)),
        ([[2, -1, 2, 1]], [[np.nan] * 3, [1.5, 0, 0.2]], (1.3, 1)),
    ],
)
def test_the_first_surface_is_hit(
    segments: list[list[float]], circles: list[list[float]], expected: tuple[float, int]
) -> None:
    distance, hit = one_beam(segments, circles)
    assert distance == pytest.approx(expected[0])
    assert hit == expected[1]


def test_a_laser_on_a_wall_sees_the_others() -> None:
    model = LaserModel(angle_min=-np.pi, angle_increment=np.pi / 2, n_beams=4, range_min=0.0, range_max=10.0)
    walls = np.array([[-1.0, 0.0, 1.0, 0.0], [-1.0, 2.0, 1.0, 2.0]])
    ranges, _ = cast_rays(np.zeros((1, 3)), model, walls, NO_CIRCLES)
    assert ranges[0, 3] in (0.0, 2.0)
    assert ranges[0, 1] in (0.0, np.inf)


def perfect(**changes: Any) -> SimulatedLaser:
    plain = replace(LMS200, noise_std_m=0.0, resolution_m=0.0, dropout_probability=0.0, mixed_probability=0.0)
    return replace(plain, **changes)


POSES = np.column_stack([np.linspace(1.5, 2.5, 600), np.zeros(600), np.linspace(0.0, 3.0, 600)])
EMPTY = np.empty((600, 0, 3))


def test_a_perfect_scanner_reads_what_is_there(rng: np.random.Generator) -> None:
    laser = perfect()
    laser = replace(laser, model=replace(laser.model, T_base_laser=(0.2, -0.1, 0.3)))
    ranges, hits = measure(POSES, laser, ROOM, EMPTY, rng)
    exact, exact_hits = cast_rays(se2.compose(POSES, np.array([0.2, -0.1, 0.3])), laser.model, ROOM, EMPTY)
    np.testing.assert_array_equal(ranges, exact)
    np.testing.assert_array_equal(hits, exact_hits)


def test_noise_and_rounding_are_those_of_the_scanner(rng: np.random.Generator) -> None:
    exact, _ = cast_rays(POSES, LMS200.model, ROOM, EMPTY)
    noisy, _ = measure(POSES, perfect(noise_std_m=0.03), ROOM, EMPTY, rng)
    error = (noisy - exact).ravel()
    assert abs(error.mean()) < 5 * 0.03 / np.sqrt(error.size)
    assert error.std() == pytest.approx(0.03, rel=0.02)
    rounded, _ = measure(POSES, perfect(resolution_m=0.25), ROOM, EMPTY, rng)
    np.testing.assert_allclose(rounded / 0.25, np.round(exact / 0.25), atol=1e-9)


def test_lost_beams_read_what_the_scanner_says(rng: np.random.Generator) -> None:
    ranges, hits = measure(POSES, perfect(dropout_probability=0.2, no_return_m=81.83), ROOM, EMPTY, rng)
    is_lost = ranges == 81.83
    assert is_lost.mean() == pytest.approx(0.2, abs=0.01)
    np.testing.assert_array_equal(hits == HIT_NOTHING, is_lost)
    far, _ = measure(POSES[:5], perfect(), ROOM + 1000.0, EMPTY[:5], rng)
    assert (far == 30.0).all()


def test_mixed_pixels_lie_between_two_surfaces(rng: np.random.Generator) -> None:
    wall = np.array([[3.0, -9.0, 3.0, 9.0]])
    person = np.broadcast_to([2.0, 0.0, 0.3], (600, 1, 3))
    still, laser = np.zeros((600, 3)), perfect(mixed_probability=1.0, footprint_rad=0.03)
    ranges, hits = measure(still, laser, wall, person, rng)
    exact, exact_hits = cast_rays(still[:1], laser.model, wall, person[:1])
    edge = np.flatnonzero(np.diff(exact_hits[0] == 0))[0] + 1
    between = (ranges[:, edge] > 2.05) & (ranges[:, edge] < 2.95)
    assert 0.05 < between.mean() < 0.5
    assert (hits[between, edge] == 0).all()  # a person has a part in it
    assert ((ranges > exact.min() - 0.05) | (hits == HIT_NOTHING)).all()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"rate_hz": 100.0}, "lms200: rate_hz must lie between 5 and 75, not 100"),
        ({"noise_std_m": -0.1}, "lms200: noise_std_m must be zero or positive, not -0.1"),
        ({"resolution_m": float("nan")}, "lms200: resolution_m must be zero or positive, not nan"),
        ({"dropout_probability": 1.5}, "lms200: dropout_probability must lie between 0 and 1, not 1.5"),
        ({"no_return_m": 20.0}, "lms200: no_return_m must not be below range_max 30, not 20"),
    ],
)
def test_impossible_scanners_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        replace(LMS200, **changes)  # type: ignore[arg-type]


def test_an_unknown_scanner_is_refused_with_those_that_are() -> None:
    with pytest.raises(ConfigError, match="unknown laser 'lidar'; known: lms200, utm30lx, lowcost360"):
        laser_named("lidar")
    assert all(laser_named(name).name == name for name in LASERS)
