from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.logs import open_log
from slammot_graph.simulation import SCENARIOS, SimulatedLog, simulate
from slammot_graph.simulation.laser import cast_rays, laser_named
from slammot_graph.simulation.people import PeopleConfig, circles
from slammot_graph.simulation.worlds import WORLDS, world_named
from tests.rooms import wall_distance

LAB = replace(SCENARIOS["lab"], n_laps=1, rate_hz=5.0)


@pytest.fixture(scope="module")
def lab() -> SimulatedLog:
    return simulate(LAB, seed=3)


def assert_equal(first: SimulatedLog, second: SimulatedLog) -> None:
    one, other = first.arrays(), second.arrays()
    assert one.keys() == other.keys()
    for key, value in one.items():
        np.testing.assert_array_equal(value, other[key])
    np.testing.assert_array_equal(first.objects, second.objects)


def test_the_same_seed_gives_the_same_bits(lab: SimulatedLog) -> None:
    assert_equal(lab, simulate(LAB, seed=3))
    np.random.default_rng(1).random(100)
    np.random.seed(7)  # noqa: NPY002  the global state does not matter
    assert_equal(lab, simulate(LAB, seed=3))


def test_another_seed_gives_another_log(lab: SimulatedLog) -> None:
    other = simulate(LAB, seed=4)
    n = min(lab.n_scans, other.n_scans)
    assert np.mean(lab.ranges[:n] == other.ranges[:n]) < 0.1
    assert np.abs(lab.T_world_base[:n] - other.T_world_base[:n]).max() > 0.05


@pytest.mark.parametrize("n_people", [0, 1, 6])
def test_more_or_fewer_people_change_their_beams_alone(lab: SimulatedLog, n_people: int) -> None:
    other = simulate(LAB, seed=3, n_people=n_people)
    np.testing.assert_array_equal(other.T_world_base, lab.T_world_base)
    np.testing.assert_array_equal(other.T_odom_base, lab.T_odom_base)
    np.testing.assert_array_equal(other.stamps, lab.stamps)
    both = min(n_people, LAB.n_people)
    np.testing.assert_array_equal(other.objects[:, :both], lab.objects[:, :both])
    is_unlabelled = ~(other.is_moving | lab.is_moving)
    np.testing.assert_array_equal(other.ranges[is_unlabelled], lab.ranges[is_unlabelled])
    assert 0.6 < is_unlabelled.mean() < 1.0


@pytest.mark.parametrize("noise_scale", [0.0, 3.0])
def test_the_odometrys_noise_changes_the_odometry_alone(lab: SimulatedLog, noise_scale: float) -> None:
    other = simulate(LAB, seed=3, noise_scale=noise_scale)
    np.testing.assert_array_equal(other.T_world_base, lab.T_world_base)
    np.testing.assert_array_equal(other.ranges, lab.ranges)
    np.testing.assert_array_equal(other.objects, lab.objects)
    np.testing.assert_array_equal(other.is_moving, lab.is_moving)
    assert np.abs(other.T_odom_base[-1] - lab.T_odom_base[-1]).max() > 0.01


def test_without_noise_the_odometry_is_exact() -> None:
    log = simulate(LAB, seed=3, noise_scale=0.0)
    driven = se2.between(log.T_world_base[0], log.T_world_base)
    apart = se2.between(driven, log.T_odom_base)
    assert np.abs(apart).max() < 1e-9


@pytest.mark.parametrize("name", ["one-walker", "two-walkers", "office"])
def test_labels_are_exact(name: str) -> None:
    """Cast again without people: what is not labelled stays, what is labelled lies on or before a person."""
    scenario = replace(SCENARIOS[name], rate_hz=5.0)
    log, alone = simulate(scenario, seed=5), simulate(scenario, seed=5, n_people=0)
    assert not alone.is_moving.any()
    np.testing.assert_array_equal(log.ranges[~log.is_moving], alone.ranges[~log.is_moving])
    np.testing.assert_array_equal(log.object_id >= 0, log.is_moving)
    assert set(np.unique(log.object_id)) - {-1} <= set(range(scenario.n_people))
    assert log.is_moving.sum() > 200
    # nearly every beam that meets a person is labelled with this person; the rest is lost or mixed
    shapes, person = circles(log.objects, log.stamps, scenario.people)
    T_world_laser = se2.compose(log.T_world_base, np.array(log.laser.T_base_laser))
    distance, hit = cast_rays(T_world_laser, log.laser, world_named(scenario.world).segments, shapes)
    meets = hit >= 0
    assert np.mean(log.object_id[meets] == person[hit[meets]]) > 0.97
    labelled = log.is_moving & meets
    assert np.mean(np.abs(log.ranges[labelled] - distance[labelled]) < 0.05) > 0.9
    assert np.mean(meets[log.is_moving]) > 0.8


@pytest.mark.parametrize("name", ["lab", "office", "corridor", "hall", "two-walkers"])
def test_people_stand_in_no_wall_and_keep_off_the_robot(name: str) -> None:
    log = simulate(replace(SCENARIOS[name], n_laps=1, rate_hz=5.0), seed=11, n_people=4)
    position = log.objects[:, :, :2]
    is_here = ~np.isnan(position[:, :, 0])
    assert is_here.mean() > 0.5
    clearance = wall_distance(position[is_here], world_named(SCENARIOS[name].world).segments)
    assert clearance.min() >= 0.2
    distance = np.linalg.norm(position - log.T_world_base[:, None, :2], axis=2)
    assert distance[is_here].min() >= 0.4
    speed = np.hypot(log.objects[is_here][:, 2], log.objects[is_here][:, 3])
    assert speed.max() < 2.5
    assert (speed > 0.3).mean() > 0.2


def test_people_move_as_fast_as_they_say(lab: SimulatedLog) -> None:
    moved = np.diff(lab.objects[:, :, :2], axis=0) / np.diff(lab.stamps)[:, None, None]
    both = ~np.isnan(moved[:, :, 0])
    np.testing.assert_allclose(moved[both], lab.objects[1:, :, 2:][both], atol=1e-9)


def test_those_who_walk_then_stop_stand_for_good() -> None:
    log = simulate(replace(SCENARIOS["two-walkers"], rate_hz=5.0), seed=2)
    share = SCENARIOS["two-walkers"].people.stop_after_share
    speed = np.hypot(log.objects[:, :, 2], log.objects[:, :, 3])
    after = int(np.ceil(share * log.n_scans)) + 15  # 3 s to come to a stand
    assert np.nanmax(speed[: after - 30]) > 0.4
    distance = np.linalg.norm(log.objects[after:, :, :2] - log.T_world_base[after:, None, :2], axis=2)
    # somebody who gives way to the robot steps aside, for a moment
    is_far = distance > PeopleConfig().keep_off_m + 0.5
    undisturbed = np.array([is_far[max(0, k - 10) : k + 1].all(axis=0) for k in range(len(is_far))])
    assert undisturbed.sum() > 50
    assert speed[after:][undisturbed].max() < 0.2


def test_people_along_stay_beside_the_robot() -> None:
    config = PeopleConfig(behaviour="along", shape="cylinder")
    log = simulate(replace(LAB, people=config, n_people=3), seed=1)
    distance = np.linalg.norm(log.objects[:, :, :2] - log.T_world_base[:, None, :2], axis=2)
    assert distance.min() > config.along_min_m - 0.15
    assert distance.max() < config.along_max_m + 0.15
    assert np.ptp(distance, axis=0).max() < 0.4


def test_the_laser_and_its_rate_take_the_place_of_the_scenarios() -> None:
    log = simulate(LAB, seed=1, laser="lowcost360", rate_hz=4.0)
    assert log.laser == laser_named("lowcost360").model
    np.testing.assert_allclose(np.diff(log.stamps), 0.25)
    assert 1.7 < simulate(LAB, seed=1, n_laps=2).n_scans / simulate(LAB, seed=1).n_scans < 2.1


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"scenario": "moon"}, 'no scenario "moon"; there are ' + ", ".join(SCENARIOS)),
        ({"n_people": -1}, "the number of people must not be negative, not -1"),
        ({"seed": -1}, "the seed must not be negative, not -1"),
        ({"noise_scale": -0.5}, "noise_scale must be zero or positive, not -0.5"),
        ({"noise_scale": float("nan")}, "noise_scale must be zero or positive, not nan"),
        ({"laser": "moon"}, "unknown laser 'moon'; known: lms200, utm30lx, lowcost360"),
        ({"rate_hz": 1.0}, "lms200: rate_hz must lie between 5 and 75, not 1"),
        ({"n_laps": -1}, "n_laps must be at least 1, not -1"),
    ],
)
def test_impossible_simulations_are_refused(changes: dict[str, object], text: str) -> None:
    arguments: dict[str, object] = {"scenario": "one-walker", "seed": 0, **changes}
    with pytest.raises(ConfigError, match=text):
        simulate(**arguments)  # type: ignore[arg-type]


def test_an_unknown_world_is_refused_with_those_that_are() -> None:
    with pytest.raises(
        ConfigError, match="unknown world 'moon'; known: lab, office, corridor, hall, building"
    ):
        simulate(replace(LAB, world="moon"), seed=0)
    assert all(scenario.world in WORLDS for scenario in SCENARIOS.values())


def test_a_log_is_read_back_as_it_was_written(lab: SimulatedLog, tmp_path: Path) -> None:
    path = tmp_path / "lab.npz"
    lab.write(path)
    log = open_log(path)
    assert log.n_scans == lab.n_scans
    scans = list(log)
    assert log.skipped == []
    for read, made in zip(scans, lab, strict=True):
        assert (read.index, read.stamp, read.laser) == (made.index, made.stamp, made.laser)
        np.testing.assert_array_equal(read.ranges, made.ranges)
        np.testing.assert_array_equal(read.T_odom_base, made.T_odom_base)
        assert read.truth is not None and made.truth is not None
        np.testing.assert_array_equal(read.truth.T_world_base, made.truth.T_world_base)
        np.testing.assert_array_equal(read.truth.is_moving, made.truth.is_moving)
        np.testing.assert_array_equal(read.truth.object_id, made.truth.object_id)
    assert [scan.index for scan in lab] == list(range(lab.n_scans))  # it may be read again


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_the_robot_drives_its_route_through_no_wall(name: str) -> None:
    scenario = replace(SCENARIOS[name], n_people=0, n_laps=1, rate_hz=5.0)
    log, world = simulate(scenario, seed=8), world_named(scenario.world)
    assert wall_distance(log.T_world_base[:, :2], world.segments).min() > 0.25
    np.testing.assert_allclose(log.T_world_base[0, :2], world.route[0], atol=1e-9)
    to_route = np.linalg.norm(log.T_world_base[:, None, :2] - world.route, axis=2).min(axis=0)
    assert to_route.max() < 0.6
    step = se2.between(log.T_world_base[:-1], log.T_world_base[1:])
    assert np.hypot(step[:, 0], step[:, 1]).max() * 5.0 < 1.11 * scenario.drive.max_speed_m_s
    assert np.abs(step[:, 2]).max() * 5.0 < 1.01 * scenario.drive.max_turn_rad_s
