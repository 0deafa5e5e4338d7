"""The map of a finished run: viewpoints, what changes before a robot that stands, and beams without a return."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GridMap
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.final_map import (
    FinalMapConfig,
    MapScan,
    dense_path,
    reliable_ranges,
    render_final_map,
    scan_weights,
    viewpoints,
)
from slammot_graph.mapping.occupancy_grid import GridConfig, NoReturnConfig, OccupancyGrid
from tests.rooms import LASER, ROOM, take_scan

CONFIG = FinalMapConfig()
T = np.array([1.0, 2.0, 0.3])


def render(ranges: list[FloatArray], poses: FloatArray, config: FinalMapConfig = CONFIG) -> GridMap:
    """Render scans of given ranges, ten a second."""
    scans = []
    for values, pose in zip(ranges, poses, strict=True):
        scan = take_scan(pose, walls=ROOM)
        scan.ranges[:] = values
        scans.append(MapScan(scan=scan, is_valid=scan.is_valid(), is_static=scan.is_valid()))
    stamps = 0.1 * np.arange(float(len(scans)))
    return render_final_map(scans.__getitem__, stamps, poses, grid=GridConfig(), config=config)


def p_at(grid: GridMap, points: FloatArray) -> FloatArray:
    i, j = np.floor((points - grid.origin)[:, ::-1] / grid.resolution_m).astype(int).T
    return np.asarray(grid.p_occupied[i, j])


def test_a_viewpoint_ends_with_distance_turn_or_time() -> None:
    poses = np.zeros((100, 3))
    poses[20:, 0], poses[30:, 2] = 0.31, 0.4
    stamps = 0.1 * np.arange(100.0)
    np.testing.assert_array_equal(viewpoints(stamps, poses, CONFIG), [0, 20, 30, 80])


def test_a_viewpoint_has_so_many_votes_and_no_more() -> None:
    config = FinalMapConfig(n_votes=5.0, n_hit_votes=2.0, n_scans=10)
    found = list(scan_weights(np.array([0, 3, 100]), 107, config))
    for which, expected in ((1, [3.0, 5.0, 5.0]), (2, [2.0, 2.0, 2.0])):
        votes = [
            sum(item[which] for item in found if a <= item[0] < b) for a, b in ((0, 3), (3, 100), (100, 107))
        ]
        np.testing.assert_allclose(votes, expected)
    assert len(found) == 3 + 10 + 7
    assert list(scan_weights(np.array([], dtype=np.int64), 0, config)) == []


def test_a_robot_that_stands_maps_what_it_sees() -> None:
    scan = take_scan(T, walls=ROOM)
    grid = render([scan.ranges] * 20, np.tile(T, (20, 1)))
    points = scan.points(T)[scan.is_valid()]
    sides = np.array([[-0.01, -0.01], [-0.01, 0.01], [0.01, -0.01]])  # some walls lie on the edges of cells
    is_mapped = np.any([p_at(grid, points + side) > 0.8 for side in sides], axis=0)
    assert np.mean(is_mapped) > 0.8
    assert np.mean(p_at(grid, T[:2] + 0.6 * (points - T[:2])) < 0.2) > 0.95
    around = T[:2] + 0.15 * np.column_stack([np.cos(np.arange(6)), np.sin(np.arange(6))])
    assert (p_at(grid, around) < 0.2).all()


@pytest.mark.parametrize(("box_s", "is_mapped"), [(range(60, 100), True), (range(20, 60), False)])
def test_what_is_put_down_comes_into_the_map_and_what_is_taken_away_goes(
    box_s: range, is_mapped: bool
) -> None:
    empty = take_scan(T, walls=ROOM).ranges
    box = empty.copy()
    box[85:96] = 0.8
    ranges = [box if k // 10 in box_s else empty for k in range(1000)]
    grid = render(ranges, np.tile(T, (1000, 1)))
    scan = take_scan(T, walls=ROOM)
    scan.ranges[:] = box
    p = p_at(grid, scan.points(T)[86:95])
    assert (p > 0.8).all() if is_mapped else (p < 0.2).all()


def test_a_minute_of_standing_does_not_outvote_a_drive_by() -> None:
    empty = take_scan(T, walls=ROOM).ranges
    person = empty.copy()
    person[88:93] = 0.8
    drive = np.column_stack([np.linspace(1.0, 1.2, 40), np.linspace(2.0, 1.1, 40), np.linspace(0.3, 0.9, 40)])
    poses = np.vstack([np.tile(T, (600, 1)), drive])
    ranges = [person] * 600 + [take_scan(pose, walls=ROOM).ranges for pose in drive]
    scan = take_scan(T, walls=ROOM)
    scan.ranges[:] = person
    assert (p_at(render(ranges[:600], poses[:600]), scan.points(T)[89:92]) > 0.8).all()
    assert (p_at(render(ranges, poses), scan.points(T)[89:92]) < 0.2).all()


@pytest.mark.parametrize(
    ("no_return", "reach_m"),
    [(NoReturnConfig(reach_m=0.6), 0.6), (NoReturnConfig(reach_m=50.0), None), (None, 0.0)],
)
def test_beams_without_a_return_free_up_to_where_the_laser_has_returned(
    no_return: NoReturnConfig | None, reach_m: float | None
) -> None:
    scan = take_scan(T, walls=ROOM)
    scan.ranges[60:120] = LASER.range_max
    reliable = float(np.quantile(scan.ranges[scan.is_valid()], 0.99))
    reach = reliable if reach_m is None else reach_m
    assert 0.7 < reliable < 0.9 * LASER.range_max
    config = FinalMapConfig(no_return=no_return, path_m=0.0)
    grid = render([scan.ranges] * 5, np.tile(T, (5, 1)), config)
    direction = scan.points(T)[90] - T[:2]
    direction /= np.linalg.norm(direction)
    low, high = grid.origin, grid.origin + grid.resolution_m * np.array(grid.p_occupied.shape)[::-1]
    for distance in np.arange(0.35, reach + 0.5, 0.1):
        point = (T[:2] + distance * direction)[None]
        is_inside = bool(((point > low) & (point < high)).all())
        is_free = is_inside and bool(p_at(grid, point)[0] < 0.2)
        if abs(distance - reach) > 0.1:
            assert is_free == (distance < reach)


def test_a_laser_that_returned_nothing_reaches_nowhere() -> None:
    scan = take_scan(T, walls=ROOM)
    scan.ranges[:] = np.inf
    assert reliable_ranges([MapScan(scan=scan, is_valid=scan.is_valid(), is_static=scan.is_valid())]) == {
        scan.laser: 0.0
    }


def test_a_path_is_filled_up_but_where_it_leaps() -> None:
    path = dense_path(np.array([[0.0, 0.0], [0.4, 0.0], [9.0, 0.0]]), 0.1)
    np.testing.assert_allclose(np.sort(path[:, 0]), [0.0, 0.08, 0.16, 0.24, 0.32, 0.4, 9.0], atol=1e-9)
    assert len(dense_path(np.zeros((1, 2)), 0.1)) == 1


def test_a_sweep_is_mapped_from_where_each_beam_was_sent_out() -> None:
    scan = take_scan(T, walls=ROOM)
    n = len(scan.ranges)
    forth = np.array([0.5, 0.0, 0.0])
    sweep = SweepMotion(
        first_s=0.0,
        last_s=0.1,
        T_stamp_base=np.linspace(0.0, 1.0, 3)[:, None] * forth,
        cov_velocity=np.zeros((3, 3)),
    )
    swept = replace(scan, beam_times=np.linspace(0.0, 0.1, n), sweep=sweep)
    is_used = scan.is_valid()
    item = MapScan(scan=swept, is_valid=is_used, is_static=is_used)
    config = FinalMapConfig(no_return=None, path_m=0.0)
    grid = render_final_map(lambda k: item, np.zeros(1), T[None], grid=GridConfig(), config=config)
    expected = OccupancyGrid(GridConfig())
    expected.add_scan(0, swept, T, swept.points(T), is_used, is_used)
    ends, origins = swept.points(T)[is_used], se2.transform(T, swept.origins_base)[is_used]
    for share in (0.1, 0.5, 1.0):
        points = origins + share * (ends - origins)
        p = expected.probability(points)
        is_same = np.abs(np.nan_to_num(p_at(grid, points), nan=0.5) - p) < 1e-6
        assert is_same.mean() > 0.98  # but for points on the edge of cells
    assert np.ptp(origins, axis=0).max() > 0.4


def test_each_of_several_lasers_has_its_own_votes() -> None:
    """Two lasers that stand and look opposite ways: each is as well mapped as by itself."""
    front = take_scan(T, walls=ROOM)
    n = len(front.ranges)
    halves = [np.where(np.arange(n) < n // 2, front.ranges, np.nan), front.ranges.copy()]
    halves[1][: n // 2] = np.nan
    lasers = np.array([0, 0, 1] * 10)  # taken for one, all chosen scans may be of the first
    ranges = [halves[k] for k in lasers]
    scans = [replace(front, ranges=values) for values in ranges]
    items = [MapScan(scan=s, is_valid=s.is_valid(), is_static=s.is_valid()) for s in scans]
    poses, stamps = np.tile(T, (len(items), 1)), 0.1 * np.arange(float(len(items)))

    def rendered(number: int | None, *, told: bool = True) -> GridMap:
        used = np.arange(len(items)) if number is None else np.flatnonzero(lasers == number)
        return render_final_map(
            lambda k: items[used[k]],
            stamps[used],
            poses[used],
            grid=GridConfig(),
            config=FinalMapConfig(path_m=0.0),
            lasers=lasers[used] if told else None,
        )

    both, as_one = rendered(None), rendered(None, told=False)
    n_less = 0
    for number in (0, 1):
        alone = rendered(number)
        item = items[int(np.flatnonzero(lasers == number)[0])]
        ends = item.scan.points(T)[item.is_valid]
        p_both, p_alone = np.nan_to_num(p_at(both, ends)), np.nan_to_num(p_at(alone, ends))
        assert (p_alone > 0.8).mean() > 0.5  # some walls lie on the edges of cells
        assert (p_both >= p_alone - 1e-6).mean() > 0.75  # what one sees at a grazing angle the other frees
        n_less += (np.nan_to_num(p_at(as_one, ends)) >= p_alone - 1e-6).mean() < 0.5
    assert n_less
