"""Company: who walks along does not pull the match away from the odometry, and counts as moving."""

import math

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.company import CompanyCheck, CompanyConfig
from slammot_graph.localization.map_matching import MapMatching
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.odometry import MotionState
from slammot_graph.registration import _company_kernels
from slammot_graph.registration._pair_kernels import partner
from tests.rooms import CORRIDOR, LASER, box, is_person, take_scan

COMPANY = np.array([[1.2, 0.4, 0.25], [-0.3, -0.7, 0.25], [1.1, -0.45, 0.25]])
STEP = np.array([0.08, 0.0, 0.0])
COV = np.diag([0.008, 0.008, 0.004]) ** 2
WIDE_ROOM = np.vstack([box(-6, -4, 6, 4.5), box(-5, -3, -4, -1)])


def plain_things(points: FloatArray, is_used: BoolArray, config: CompanyConfig) -> IntArray:
    used = np.flatnonzero(is_used)
    thing = np.full(len(points), -1)
    gaps = np.hypot(*np.diff(points[used], axis=0).T)
    reach = config.gap_m + config.gap_ratio * np.hypot(*points[used[1:]].T)
    number = 0
    for part in np.split(used, np.flatnonzero(gaps > reach) + 1):
        if math.hypot(*np.ptp(points[part], axis=0)) <= config.width_m:
            thing[part] = number
            number += 1
    return thing


def test_small_things_are_the_short_runs_of_neighbouring_points(rng: np.random.Generator) -> None:
    config = CompanyConfig()
    for _ in range(20):
        n = 200
        jumps = np.cumsum(rng.choice([0.02, 0.6], n, p=[0.9, 0.1]))
        points = np.column_stack([jumps, 1.0 + 0.01 * rng.standard_normal(n)])
        is_used = rng.random(n) < 0.9
        thing = np.empty(n, dtype=np.int64)
        n_things = _company_kernels.small_things(
            points, is_used, config.gap_m, config.gap_ratio, config.width_m, thing
        )
        np.testing.assert_array_equal(thing, plain_things(points, is_used, config))
        assert n_things == thing.max() + 1 > 1


def matching(walls: FloatArray, config: ScanToMapConfig, seen_from: FloatArray) -> MapMatching:
    """On a local map of what a keyframe at a pose (3,) saw of walls and company around the origin."""
    local_map, first = LocalMap(LocalMapConfig()), take_scan(seen_from, walls=walls, discs=COMPANY.tolist())
    keyframe = make_keyframe(0, seen_from, first.points_base(), first.is_valid(), LASER, local_map.config)
    local_map.add(keyframe)
    matching = MapMatching(config, local_map)
    matching.start_scan(LASER.origin_base, np.zeros(3), has_odometry=True)
    return matching


def state_at(T: FloatArray) -> MotionState:
    return MotionState(
        T_local_base=T,
        cov_prior=COV,
        cov_independent=COV,
        cov_correlated=np.zeros((3, 3)),
        cov_odometry=COV,
        cov_motion=COV,
    )


def moved(discs: FloatArray) -> FloatArray:
    return np.column_stack([se2.transform(STEP, discs[:, :2]), discs[:, 2]])


def test_who_sets_out_with_the_robot_does_not_hold_it_back() -> None:
    scan = take_scan(STEP, walls=CORRIDOR, discs=moved(COMPANY).tolist())
    points, is_valid = scan.points_base(), scan.is_valid()
    person = is_person(scan)
    errors_m, stds_m = [], []
    for company in (None, CompanyConfig()):
        found = matching(CORRIDOR, ScanToMapConfig(company=company), np.zeros(3))
        match, state = found.match(points, is_valid, state_at(STEP))
        errors_m.append(abs(state.T_local_base[0] - STEP[0]))
        stds_m.append(math.sqrt(state.cov_independent[0, 0]))
    assert errors_m[0] > 0.02
    assert errors_m[1] < 0.005
    assert stds_m[1] > stds_m[0]
    assert match.walks_along is not None
    assert (match.walks_along & person).sum() > 0.9 * person.sum()


@pytest.mark.parametrize("has_odometry", [True, False])
def test_the_odometry_slips_where_the_walls_tell_so(has_odometry: bool) -> None:
    """Nothing has moved, but the odometry says so: the walls agree with the small things."""
    scan = take_scan(np.zeros(3), walls=WIDE_ROOM, discs=COMPANY.tolist())
    found = matching(WIDE_ROOM, ScanToMapConfig(company=CompanyConfig()), np.zeros(3))
    found.start_scan(LASER.origin_base, np.zeros(3), has_odometry=has_odometry)
    match, _ = found.match(scan.points_base(), scan.is_valid(), state_at(STEP))
    assert match.walks_along is None


def test_what_was_seen_from_elsewhere_stays_where_it_is() -> None:
    """Down a corridor the odometry slips, and small things that a keyframe has passed by tell of it."""
    scan = take_scan(np.zeros(3), walls=CORRIDOR, discs=COMPANY.tolist())
    suspects = []
    for seen_from in (np.zeros(3), np.array([-0.8, 0.0, 0.0])):
        found = matching(CORRIDOR, ScanToMapConfig(company=CompanyConfig()), seen_from)
        match, _ = found.match(scan.points_base(), scan.is_valid(), state_at(STEP))
        suspects.append(
            0 if match.walks_along is None else np.count_nonzero(match.walks_along & is_person(scan))
        )
    assert suspects[0] > 10
    assert suspects[1] < 0.5 * suspects[0]


def test_without_odometry_nothing_tells_company_from_the_building() -> None:
    scan = take_scan(STEP, walls=CORRIDOR, discs=moved(COMPANY).tolist())
    found = matching(CORRIDOR, ScanToMapConfig(company=CompanyConfig()), np.zeros(3))
    found.start_scan(LASER.origin_base, np.zeros(3), has_odometry=False)
    match, _ = found.match(scan.points_base(), scan.is_valid(), state_at(STEP))
    assert match.walks_along is None


def test_only_those_who_pull_walk_along() -> None:
    """One of three sets out, while the robot and the others stand."""
    discs = COMPANY.copy()
    discs[0, 0] += 0.08
    scan = take_scan(np.zeros(3), walls=CORRIDOR, discs=discs.tolist())
    found = matching(CORRIDOR, ScanToMapConfig(company=CompanyConfig()), np.zeros(3))
    suspects = found._company.suspects(  # type: ignore[union-attr]
        found.local_map, scan.points_base(), scan.is_valid(), np.zeros(3)
    )
    assert suspects is not None
    pulling = found._company.pulling(  # type: ignore[union-attr]
        found.local_map, scan.points_base(), suspects, np.array([-0.04, 0.0, 0.0]), np.zeros(3)
    )
    assert scan.truth is not None
    who = scan.truth.object_id
    assert pulling[who == 0].mean() > 0.9
    assert not pulling[(who == 1) | (who == 2)].any()


def floor_before(T_local_base: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Returns of a robot down a corridor before which the floor comes up, base frame; and those on it."""
    scan = take_scan(T_local_base, walls=CORRIDOR)
    floor = 1.5 / np.maximum(np.cos(LASER.angles_base), 0.05)
    is_floor = floor < scan.ranges
    scan.ranges[:] = np.minimum(scan.ranges, floor)
    return scan.points_base(), scan.is_valid() & is_floor


def test_what_comes_up_before_the_robot_speaks_for_no_leap() -> None:
    local_map = LocalMap(LocalMapConfig())
    for k, x_m in enumerate((-1.0, 0.0)):
        T = np.array([x_m, 0.0, 0.0])
        scan = take_scan(T, walls=CORRIDOR)
        points, is_used = scan.points_base(), scan.is_valid()
        if k == 1:
            points, is_used = floor_before(T)[0], np.ones_like(is_used)
        local_map.add(make_keyframe(k, T, points, is_used, LASER, local_map.config))
    check, predicted, held = CompanyCheck(CompanyConfig()), np.array([0.4, 0.0, 0.0]), np.zeros(3)
    points, is_floor = floor_before(predicted)
    assert np.count_nonzero(is_floor) > 20
    everything = np.ones(len(points), dtype=np.bool_)
    assert check.support(local_map, points, everything, predicted, held).rides_along
    # the odometry has slipped: what was seen from elsewhere tells so
    still = take_scan(held, walls=CORRIDOR)
    assert not check.support(local_map, still.points_base(), still.is_valid(), predicted, held).rides_along


def test_what_only_one_pose_explains_is_counted_as_its_twin_does(rng: np.random.Generator) -> None:
    local_map = LocalMap(LocalMapConfig())
    for k in range(3):
        T = np.array([0.4 * k, 0.0, 0.0])
        scan = take_scan(T, walls=WIDE_ROOM)
        local_map.add(make_keyframe(k, T, scan.points_base(), scan.is_valid(), LASER, local_map.config))
    T = np.array([0.9, 0.1, 0.02])
    there = se2.transform(T, take_scan(T, walls=WIDE_ROOM).points_base())
    at, before = (there + rng.normal(0.0, std_m, there.shape) for std_m in (0.1, 0.2))
    is_used, counts = rng.random(len(at)) < 0.8, np.empty((3, 2), dtype=np.int64)
    _company_kernels.count_supported(
        at,
        before,
        is_used,
        *local_map.owned_points,
        0.1,
        T[0],
        T[1],
        0.5,
        counts,
    )

    def near(points: FloatArray) -> IntArray:
        arguments = local_map.points, local_map.nearest, local_map.inv_cell, local_map.first, 0.1**2
        return np.array([partner(x, y, *arguments) for x, y in points.tolist()])

    m, other = near(at), near(before)
    at_rows = (m >= 0) & (other < 0), (m < 0) & (other >= 0), (m >= 0) & (other >= 0)
    row = np.where(m >= 0, m, other)
    is_far = np.hypot(*(local_map.T_local_keyframes[local_map.owner[row], :2] - T[:2]).T) > 0.5
    for k, is_row in enumerate(at_rows):
        for column, is_there in enumerate((~is_far, is_far)):
            assert counts[k, column] == np.count_nonzero(is_used & is_row & is_there) > 0
