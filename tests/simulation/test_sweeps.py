"""Lasers that sweep while the robot drives and people walk."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.simulation import simulate
from slammot_graph.simulation.injection import _Base
from slammot_graph.simulation.laser import LMS200, LOWCOST360, cast_rays, cast_sweeps
from slammot_graph.simulation.scenarios import scenario_named
from slammot_graph.simulation.sweeps import beam_poses, poses_between
from slammot_graph.simulation.worlds import world_named


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_each_beam_is_cast_from_its_own_pose(rng: np.random.Generator, sense: float) -> None:
    world = world_named("lab")
    model = LOWCOST360.model
    model = replace(model, angle_min=sense * model.angle_min, angle_increment=sense * model.angle_increment)
    T = np.array([*world.route[0], 0.3]) + np.linspace(0.0, 1.0, 360)[:, None] * [0.1, 0.05, 0.4]
    circles = np.array([[[*(world.route[0] + 0.5), 0.2]], [[*(world.route[0] + 0.5), 0.2]]])
    ranges, hits = cast_sweeps(T[None], model, world.segments, circles[None])
    for k in range(0, 360, 7):
        expected, hit = cast_rays(T[k : k + 1], model, world.segments, circles[:1])
        assert ranges[0, k] == pytest.approx(expected[0, k], abs=1e-9)
        assert hits[0, k] == hit[0, k]


def test_the_drive_is_that_of_the_snapshots() -> None:
    scenario = replace(scenario_named("fast-turns"), world="lab")
    swept, snapshots = (simulate(scenario, seed=3, sweep=sweep) for sweep in (1.0, 0.0))
    np.testing.assert_array_equal(swept.T_world_base, snapshots.T_world_base)
    np.testing.assert_array_equal(swept.T_odom_base, snapshots.T_odom_base)
    np.testing.assert_array_equal(swept.objects, snapshots.objects)
    assert swept.time_increment_s == pytest.approx(1.0 / 7.0 / 360.0) and not snapshots.time_increment_s
    # the robot rests at first: without people in its way a beam reads the same
    is_person = swept.is_moving[:5] | snapshots.is_moving[:5]
    np.testing.assert_array_equal(swept.ranges[:5][~is_person], snapshots.ranges[:5][~is_person])
    turning = np.abs(np.diff(swept.T_world_base[:, 2])) > 0.1
    assert (swept.ranges[:-1][turning] != snapshots.ranges[:-1][turning]).mean() > 0.5
    scan = next(iter(swept))
    assert scan.beam_times is not None and next(iter(snapshots)).beam_times is None


def test_beams_follow_the_drive() -> None:
    dense = np.column_stack([np.arange(9.0), np.zeros(9), 0.9 * np.pi + 0.1 * np.arange(9.0)])
    dense[:, 2] = se2.wrap_angle(dense[:, 2])
    poses = beam_poses(dense, 0.5, np.array([10.0, 12.0]), np.array([0.0, 0.25, 1.9]))
    np.testing.assert_allclose(poses[:, :, 0], [[0.0, 0.5, 3.8], [4.0, 4.5, 7.8]])
    np.testing.assert_allclose(poses[1, :, 2] - 0.9 * np.pi, [0.4, 0.45, 0.78])


def test_a_sweep_lasts_no_longer_than_a_turn() -> None:
    with pytest.raises(ConfigError, match="sweep"):
        replace(LMS200, sweep=1.5)


def test_people_injected_into_sweeps_are_met_beam_by_beam() -> None:
    """The same person at the same place reads as in the simulation itself, where no edge is near."""
    scenario = replace(scenario_named("fast-turns"), world="lab", n_people=0)
    log = simulate(scenario, seed=3)
    base = _Base(log, log.T_world_base, 60)
    objects = np.full((60, 1, 4), np.nan)
    objects[:] = [*(log.T_world_base[30, :2] + [1.0, 0.3]), 0.0, 0.0]
    injected = base.with_people(objects, scenario.people, np.random.default_rng(0))
    assert injected.time_increment_s == pytest.approx(log.time_increment_s)
    assert injected.is_moving.any()
    poses = poses_between(log.T_world_base[:60], log.stamps[:60], log.time_increment_s * np.arange(360.0))
    for k, beam in np.argwhere(injected.is_moving)[::5]:
        angle = poses[k, beam, 2] + log.laser.angle_min + log.laser.angle_increment * beam
        end = poses[k, beam, :2] + injected.ranges[k, beam] * np.array([np.cos(angle), np.sin(angle)])
        assert np.hypot(*(end - objects[k, 0, :2])) < 0.45
