import math
from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel
from slammot_graph.evaluation import absolute_error
from slammot_graph.run import Run
from slammot_graph.simulation import simulate
from slammot_graph.simulation.laser import HIT_STATIC, cast_rays
from slammot_graph.simulation.scenarios import scenario_named
from slammot_graph.simulation.surfaces import LEAST_WALL_M, Surfaces, choose_walls

MODEL = LaserModel(
    angle_min=-math.pi / 3, angle_increment=math.pi / 6, n_beams=5, range_min=0.0, range_max=20.0
)
WALL = np.array([4.0, -9.0, 4.0, 9.0])
BEHIND = np.array([-3.0, -20.0, -3.0, 20.0])
SEGMENTS = np.array([WALL, BEHIND])
NOTHING = np.empty((0, 4))


def seen(*, glass: np.ndarray = NOTHING, mirrors: np.ndarray = NOTHING) -> tuple[np.ndarray, np.ndarray]:
    """Ranges of one scan from the origin, without and with the surfaces."""
    T = np.zeros((1, 3))
    ranges, hits = cast_rays(T, MODEL, SEGMENTS, np.empty((1, 0, 3)))
    assert (hits == HIT_STATIC).all()
    changed = Surfaces(segments=SEGMENTS, glass=glass, mirrors=mirrors).seen(ranges, hits, T, MODEL, math.inf)
    return ranges[0], changed[0]


def test_glass_returns_beams_at_right_angles_alone() -> None:
    ranges, changed = seen(glass=WALL[None])
    assert changed[2] == ranges[2] == 4.0
    assert np.isinf(changed[[0, 1, 3, 4]]).all()


def test_a_mirror_returns_what_it_shows_at_the_length_of_the_whole_way() -> None:
    ranges, changed = seen(mirrors=WALL[None])
    # to the wall at x = 4 and back to the one at x = -3; the ray goes on from just before the mirror
    angles = MODEL.angle_min + MODEL.angle_increment * np.arange(5)
    whole = (4.0 + 7.0) / np.cos(angles)
    expected = np.where(whole <= MODEL.range_max, whole, math.inf)
    np.testing.assert_allclose(changed, expected, atol=0.45)
    np.testing.assert_allclose(ranges, 4.0 / np.cos(angles))


def test_people_before_glass_are_seen() -> None:
    T, ranges = np.zeros((1, 3)), np.full((1, 5), 3.99)
    hits = np.full((1, 5), 0)
    surfaces = Surfaces(segments=SEGMENTS, glass=SEGMENTS, mirrors=NOTHING)
    out = surfaces.seen(ranges, hits, T, MODEL, math.inf)
    np.testing.assert_array_equal(out, ranges)


def test_long_walls_are_chosen() -> None:
    segments = np.array([[0.0, 0.0, 0.5 * LEAST_WALL_M, 0.0], [0.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 3.0]])
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(choose_walls(segments, 1.0, rng), segments[1:])
    assert not len(choose_walls(segments, 0.0, rng))
    with pytest.raises(ConfigError, match="share of the walls"):
        choose_walls(segments, 1.5, rng)


def test_a_run_among_glass_and_mirrors_keeps_its_way() -> None:
    log = simulate(replace(scenario_named("one-walker"), glass=0.15, mirrors=0.05), seed=3)
    plain = simulate("one-walker", seed=3)
    is_lost = (log.ranges >= 0.97 * log.laser.range_max) & (plain.ranges < 0.97 * log.laser.range_max)
    assert is_lost.mean() > 0.02
    result = Run(log, "graph", max_scans=300).complete()
    assert absolute_error(result.T_map_base, log.T_world_base[:300]).translation_m.rmse < 0.02


def test_sweeps_see_neither() -> None:
    with pytest.raises(ConfigError, match="do not sweep"):
        simulate(replace(scenario_named("one-walker"), sweep=1.0, glass=0.1), seed=0)
