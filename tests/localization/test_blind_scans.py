"""Scans that tell nothing of where the robot is."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core.scan import Scan
from slammot_graph.localization.blind_scans import Blindness, BlindScans
from tests.rooms import take_scan


def scan_at(k: int, x_m: float, *, noise_m: float = 0.01, theta: float = 0.0) -> Scan:
    """Scan k of ten a second, from x_m along a room."""
    scan = take_scan(np.array([x_m, 0.0, theta]))
    noise = np.random.default_rng(k).normal(0.0, noise_m, len(scan.ranges))
    odometry = np.array([x_m, 0.0, theta])
    return replace(scan, index=k, stamp=0.1 * k, ranges=scan.ranges + noise, T_odom_base=odometry)


def judged(scans: list[Scan]) -> list[Blindness | None]:
    blind = BlindScans()
    return [blind.look_at(scan) for scan in scans]


def test_a_drive_is_not_blind() -> None:
    assert set(judged([scan_at(k, 0.1 * k, theta=0.15 * k) for k in range(30)])) == {None}


def test_a_robot_that_stands_may_see_the_same_again() -> None:
    assert set(judged([scan_at(0, 1.0)] * 20)) == {None}


def test_the_same_scan_again_while_the_odometry_moves_is_no_measurement() -> None:
    frozen = scan_at(4, 0.4).ranges
    scans = [scan_at(k, 0.1 * k) for k in range(5)]
    scans += [replace(scan_at(k, 0.1 * k), ranges=frozen) for k in range(5, 15)] + [scan_at(15, 1.5)]
    assert judged(scans) == [None] * 5 + ["repeated"] * 10 + [None]
    without = [replace(scan, T_odom_base=None) for scan in scans]
    assert set(judged(without)) == {None}  # nobody says that it moves


def test_old_scans_in_turn_are_no_measurement_either() -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(30)]
    for k in range(10, 30):
        scans[k] = replace(scans[k], ranges=scans[7 + k % 3].ranges)
    assert judged(scans) == [None] * 10 + ["repeated"] * 20


@pytest.mark.parametrize(("step_m", "told"), [(0.1, "repeated"), (0.005, None)])
def test_without_odometry_a_moving_robot_does_not_stop_dead(step_m: float, told: Blindness | None) -> None:
    blind = BlindScans()
    scans = [replace(scan_at(k, step_m * k), T_odom_base=None) for k in range(5)]
    for scan in scans:
        assert blind.look_at(scan) is None
        blind.found_at(np.array([step_m * scan.index, 0.0, 0.0]))
    for k in range(5, 10):
        assert blind.look_at(replace(scans[-1], index=k, stamp=0.1 * k)) == told
        blind.found_at(np.array([step_m * 4, 0.0, 0.0]))


@pytest.mark.parametrize("n_fading", [1, 4])
def test_a_laser_is_covered_until_it_sees_far_again(n_fading: int) -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(40)]
    n = len(scans[0].ranges)
    for k in range(10, 30):
        share = min((k - 9) / n_fading, 1.0)
        cover = np.random.default_rng(k).normal(0.3, 0.01, n)
        ranges = np.where(np.arange(n) < share * n, cover, scans[k].ranges)
        scans[k] = replace(scans[k], ranges=ranges)
    told = judged(scans)
    first = 9 + n_fading
    assert told[first:30] == ["covered"] * (30 - first)
    assert set(told[:10] + told[30:]) == {None}
    assert set(told[10:first]) <= {None, "partly covered"}


@pytest.mark.parametrize(("distance_m", "share"), [(0.15, 1.0), (0.3, 0.85), (0.6, 0.85), (0.6, 1.0)])
def test_a_laser_is_covered_beside_walls_too(distance_m: float, share: float) -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(40)]
    n = len(scans[0].ranges)
    for scan in scans:
        scan.ranges[: n // 3] = 0.8  # what was near before does not shorten by much
    for k in range(10, 30):
        cover = distance_m + 0.03 * np.sin(0.3 * k) + np.random.default_rng(k).normal(0.0, 0.01, n)
        scans[k] = replace(scans[k], ranges=np.where(np.arange(n) < share * n, cover, scans[k].ranges))
    assert judged(scans) == [None] * 10 + ["covered"] * 20 + [None] * 10


def test_a_closet_that_the_robot_was_kidnapped_into_is_known_by_driving_in_it() -> None:
    scans = [scan_at(k, 0.0) for k in range(10)]
    for scan in scans:
        scan.ranges[:] = 4.0
    y = np.linspace(0.0, 0.8, 30)
    angles = scans[0].laser.angles_base
    for k in range(30):  # round walls of 0.9 m, through which it drives
        ahead = y[k] * np.cos(angles)
        ranges = -ahead + np.sqrt(ahead**2 + 0.81 - y[k] ** 2)
        scans.append(replace(scan_at(10 + k, y[k]), ranges=ranges))
    told = judged(scans)
    assert told[10:15] == ["covered"] * 5
    assert set(told[-10:]) == {None}


def test_beams_that_a_cover_leaves_free_are_used() -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(40)]
    is_cut = np.arange(len(scans[0].ranges)) < 0.65 * len(scans[0].ranges)
    for k in range(10, 30):
        scans[k] = replace(scans[k], ranges=np.where(is_cut, 0.9, scans[k].ranges))
    blind = BlindScans()
    free = [blind.emptied(scan)[0] for scan in scans]
    for k in range(10, 30):
        assert not np.isfinite(free[k].ranges[is_cut]).any()
        np.testing.assert_array_equal(free[k].ranges[~is_cut], scans[k].ranges[~is_cut])
    assert all(free[k] is scans[k] for k in (*range(10), *range(30, 40)))


def test_without_odometry_the_matches_tell_that_a_cover_rides_along() -> None:
    scans = [replace(scan_at(k, 0.1 * k), T_odom_base=None) for k in range(40)]
    is_cut = np.arange(len(scans[0].ranges)) < 0.65 * len(scans[0].ranges)
    for k in range(10, 30):
        scans[k] = replace(scans[k], ranges=np.where(is_cut, 0.9, scans[k].ranges))
    blind, told = BlindScans(), []
    for k, scan in enumerate(scans):
        told.append(blind.look_at(scan))
        blind.found_at(np.array([0.1 * k, 0.0, 0.0]))
    assert told == [None] * 10 + ["partly covered"] * 20 + [None] * 10


def test_somebody_who_steps_before_the_laser_does_not_cover_it() -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(20)]
    n = len(scans[0].ranges)
    for k in range(10, 20):
        scans[k] = replace(scans[k], ranges=np.where(np.arange(n) < 0.5 * n, 0.4, scans[k].ranges))
    assert set(judged(scans)) == {None}


def test_nothing_is_said_after_a_gap() -> None:
    near = np.full(len(scan_at(0, 0.0).ranges), 0.3)
    scans = [scan_at(k, 0.1 * k) for k in range(10)]
    assert judged([*scans, replace(scan_at(40, 4.0), ranges=near)])[-1] is None


def test_a_hall_beyond_reach_looks_the_same_everywhere() -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(10)]
    limit = scans[0].laser.range_max
    assert set(judged([replace(x, ranges=np.full(len(x.ranges), limit)) for x in scans])) == {None}


def test_a_laser_that_saw_nothing_before_is_not_covered_by_what_it_sees_then() -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(20)]
    for k in (8, 9, 10):
        scans[k].ranges[:] = np.inf
    assert set(judged(scans)) == {None}


def test_a_robot_kidnapped_into_a_smaller_room_is_not_covered() -> None:
    scans = [scan_at(k, 0.1 * k) for k in range(20)]
    for scan in scans[:10]:
        scan.ranges[:] *= 2.5  # up to there in a larger one
    assert set(judged(scans)) == {None}
