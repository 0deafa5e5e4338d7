"""Furniture that is moved between two drives."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph import ConfigError
from slammot_graph.simulation import SCENARIOS, simulate
from slammot_graph.simulation.furniture import pieces_of, with_moved_furniture
from slammot_graph.simulation.worlds import world_named


def test_walls_are_no_furniture() -> None:
    lab = world_named("lab")
    pieces = pieces_of(lab.segments)
    assert len(pieces) == 10
    for rows in pieces:
        np.testing.assert_allclose(lab.segments[rows[0], :2], lab.segments[rows[-1], 2:])
        assert np.ptp(lab.segments[rows].reshape(-1, 2), axis=0).max() <= 2.5
    assert len(pieces_of(world_named("corridor").segments)) == 4


@pytest.mark.parametrize("name", ["lab", "office", "hall"])
def test_a_share_of_the_furniture_is_moved(name: str) -> None:
    world = world_named(name)
    pieces = pieces_of(world.segments)
    moved, is_moved = with_moved_furniture(world, 0.3, 1)
    np.testing.assert_array_equal(moved.segments[~is_moved], world.segments[~is_moved])
    n_moved = sum(bool(is_moved[rows].all()) for rows in pieces)
    assert is_moved.sum() == sum(len(rows) for rows in pieces if is_moved[rows].any())
    assert n_moved == round(0.3 * len(pieces))
    for rows in pieces:
        way = (moved.segments[rows] - world.segments[rows]).reshape(-1, 2).mean(axis=0)
        assert not is_moved[rows[0]] or 0.49 < np.hypot(*way) < 1.51
        sizes = [np.hypot(*(s[rows, 2:] - s[rows, :2]).T) for s in (world.segments, moved.segments)]
        np.testing.assert_allclose(*sizes)
    again, _ = with_moved_furniture(world, 0.3, 1)
    np.testing.assert_array_equal(again.segments, moved.segments)


def test_the_drive_is_the_same_and_the_view_another() -> None:
    scenario = replace(SCENARIOS["lab"], rate_hz=5.0)
    before = simulate(scenario, seed=3, n_people=0)
    after = simulate(replace(scenario, moved=0.3, moved_seed=1), seed=3, n_people=0)
    np.testing.assert_array_equal(before.T_world_base, after.T_world_base)
    np.testing.assert_array_equal(before.T_odom_base, after.T_odom_base)
    assert 0.05 < np.mean(np.abs(before.ranges - after.ranges) > 0.2) < 0.6


def test_a_share_beyond_all_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"from 0 to 1, not 1\.5"):
        with_moved_furniture(world_named("lab"), 1.5, 0)
