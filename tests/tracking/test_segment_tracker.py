import math

import numpy as np
import pytest

from slammot_graph.tracking import _sight_kernels
from slammot_graph.tracking.base import ScanView, Track
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.segment_tracker import SegmentTracker

INCREMENT = math.radians(0.5)
ANGLES = np.arange(-math.pi / 2, math.pi / 2, INCREMENT)
WALL_M = 8.0
NO_CENTRES = np.empty((0, 2)), np.empty((0, 2, 2)), ()


def legs(x: float, y: float, phase: float) -> list[tuple[float, float, float]]:
    """Two legs of a person who walks along y, as circles."""
    swing = 0.2 * math.sin(phase)
    return [(x - 0.11, y + swing, 0.065), (x + 0.11, y - swing, 0.065)]


def view_of(circles: list[tuple[float, float, float]], is_moving: list[bool] | None = None) -> ScanView:
    """A scan from the origin, along x, of circles before a round wall."""
    ranges, hit = np.full(len(ANGLES), WALL_M), np.full(len(ANGLES), -1)
    for c, (x, y, r) in enumerate(circles):
        along = x * np.cos(ANGLES) + y * np.sin(ANGLES)
        aside2 = x * x + y * y - along**2
        inside = (aside2 < r * r) & (along > 0)
        near = along - np.sqrt(np.where(inside, r * r - aside2, 0.0))
        closer = inside & (near < ranges)
        ranges[closer], hit[closer] = near[closer], c
    moves = np.array([True] * len(circles) if is_moving is None else is_moving, dtype=bool)
    moving = (hit >= 0) & np.append(moves, False)[hit]
    return ScanView(
        points=ranges[:, None] * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)]),
        packed_cov=np.tile([1e-4, 0.0, 1e-4], (len(ANGLES), 1)),
        cluster=np.where(moving, 0, -1),
        is_proven=moving,
        T_local_laser=np.zeros(3),
        angle_min=float(ANGLES[0]),
        angle_increment=INCREMENT,
        ranges=ranges,
        is_valid=np.full(len(ANGLES), True),
        no_return_m=math.inf,
    )


class Watched:
    """A tracker with its clock."""

    def __init__(self) -> None:
        self.tracker = SegmentTracker(SegmentTrackerConfig())
        self.now_s = 0.0

    def see(
        self, circles: list[tuple[float, float, float]], is_moving: list[bool] | None = None
    ) -> list[Track]:
        self.now_s += 0.1
        self.tracker.update(self.now_s, *NO_CENTRES, None, view_of(circles, is_moving))
        return self.tracker.shown()

    def walk(self, n: int, x: float = 3.0, y0: float = -1.5, speed: float = 1.0) -> list[list[Track]]:
        return [self.see(legs(x, y0 + 0.1 * speed * k, 0.5 * k)) for k in range(n)]


def test_two_legs_are_one_person_whose_centre_is_between_them() -> None:
    shown = Watched().walk(30)
    assert [len(tracks) for tracks in shown[:3]] == [0, 1, 1]  # the first sightings have many points
    assert {track.track_id for tracks in shown for track in tracks} == {0}
    last = shown[-1][0]
    np.testing.assert_allclose(last.state[:2], [3.0, -1.5 + 2.9], atol=0.08)
    np.testing.assert_allclose(last.state[2:], [0.0, 1.0], atol=0.3)
    assert len(last.beams) > 4


def test_the_sightings_are_those_of_the_latest_scan() -> None:
    watched = Watched()
    watched.walk(5)
    seen = watched.tracker.sightings
    assert seen.ids.tolist() == [0]
    np.testing.assert_allclose(seen.places, [[3.0, -1.1]], atol=0.1)
    assert 0.2 < seen.sizes_m[0] < 0.7
    watched.see([])
    assert len(watched.tracker.sightings.ids) == 0


def test_a_track_that_the_laser_sees_through_is_not_shown_and_ends() -> None:
    watched = Watched()
    watched.walk(20)
    assert watched.see([]) == []
    for _ in range(8):
        watched.see([])
    assert watched.tracker.tracks == []


def test_an_occluded_track_goes_on_unshown_and_keeps_its_identity() -> None:
    watched = Watched()
    watched.walk(20)
    pillar = (1.0, 0.28, 0.22)
    before = [watched.see([pillar], [False]) for _ in range(5)]
    assert [len(tracks) for tracks in before] == [1, 1, 1, 0, 0]
    for k in range(5):
        (back,) = watched.see(legs(3.0, -1.5 + 0.1 * (25 + k), 0.5 * k))
        assert back.track_id == 0


def test_an_object_out_of_view_ends_late() -> None:
    watched = Watched()
    watched.walk(20, y0=-1.5)
    # turned away: the laser of this scan looks backward
    away = view_of([])
    for k in range(35):
        turned = ScanView(**{**vars(away), "T_local_laser": np.array([0.0, 0.0, math.pi])})
        watched.tracker.update(watched.now_s + 0.1 * (k + 1), *NO_CENTRES, None, turned)
        assert bool(watched.tracker.tracks) == (0.1 * (k + 1) < 3.05)


def test_who_stands_still_and_does_not_move_any_more_is_kept() -> None:
    watched = Watched()
    watched.walk(20)
    at = -1.5 + 1.9
    for k in range(8):  # comes to a stand
        watched.see(legs(3.0, at + 0.02 * k, 0.0))
    for _ in range(30):
        (stands,) = watched.see(legs(3.0, at + 0.14, 0.0), [False, False])
    assert stands.track_id == 0
    assert math.hypot(*stands.state[2:]) < 0.1


def test_who_came_while_nobody_looked_and_stands_is_kept() -> None:
    watched = Watched()
    for _ in range(20):  # on cells that were free before, but never seen to move
        watched.see(legs(3.0, 0.4, 0.0))
    for _ in range(30):
        (stands,) = watched.see(legs(3.0, 0.4, 0.0), [False, False])
    assert stands.track_id == 0
    unproven = Watched()
    for _ in range(5):
        unproven.see(legs(3.0, 0.4, 0.0))
    for _ in range(30):
        last = unproven.see(legs(3.0, 0.4, 0.0), [False, False])
    assert last == []


def test_who_comes_back_does_not_take_the_leg_of_another() -> None:
    watched = Watched()
    for k in range(20):
        watched.see(legs(3.0, -1.5 + 0.1 * k, 0.5 * k) + legs(3.0, 2.5 - 0.1 * k, 0.5 * k))
    pillar = (1.5, 0.24, 0.1)  # hides the second one for good
    for k in range(20):
        shown = watched.see([*legs(3.0, 0.4 - 0.01 * k, 0.5 * k), pillar], [True, True, False])
    assert len(shown) == 1
    assert len(watched.tracker.sightings.ids) == 1


def test_a_wall_is_nobody_who_stands() -> None:
    watched = Watched()
    watched.walk(20)
    wall = [(3.3, 0.4 + 0.1 * k, 0.08) for k in range(-12, 12)]
    watched.see(wall, [False] * len(wall))
    assert len(watched.tracker.sightings.ids) == 0


def test_two_people_side_by_side_are_two() -> None:
    watched = Watched()
    for k in range(25):
        y = -1.5 + 0.1 * k
        shown = watched.see(legs(2.5, y, 0.5 * k) + legs(3.5, y, 0.5 * k + 1.0))
    assert sorted(track.track_id for track in shown) == [0, 1]


def test_beams_that_no_free_cell_proves_begin_no_track_and_keep_none_alive() -> None:
    def unproven(view: ScanView) -> ScanView:
        return ScanView(**{**vars(view), "is_proven": np.zeros(len(ANGLES), dtype=bool)})

    tracker = SegmentTracker(SegmentTrackerConfig())
    for k in range(10):
        tracker.update(0.1 * k, *NO_CENTRES, None, unproven(view_of(legs(3.0, 0.0, 0.3 * k))))
    assert tracker.tracks == []
    watched = Watched()
    watched.walk(10)
    for k in range(12):
        view = unproven(view_of(legs(3.0, -0.5, 0.3 * k)))
        watched.tracker.update(watched.now_s + 0.1 * (k + 1), *NO_CENTRES, None, view)
    assert watched.tracker.tracks == []


def test_without_a_view_clusters_are_segments() -> None:
    tracker = SegmentTracker(SegmentTrackerConfig())
    for k in range(10):
        tracker.update(
            0.1 * k, np.array([[0.1 * k, 0.0]]), 1e-4 * np.eye(2)[None], [np.arange(5)], np.array([True])
        )
    (track,) = tracker.shown()
    np.testing.assert_allclose(track.state, [0.9, 0.0, 1.0, 0.0], atol=0.25)
    assert track.beams.tolist() == [0, 1, 2, 3, 4]
    assert tracker.displaced() == []
    for k in range(10, 14):
        tracker.update(0.1 * k, np.array([[0.1 * k, 0.0]]), 1e-4 * np.eye(2)[None], [np.arange(5)])
    assert len(tracker.displaced()) == 1
    np.testing.assert_allclose(tracker.predicted_positions(1.8), [[1.8, 0.0]], atol=0.15)


def test_a_stamp_that_runs_backward_is_no_time() -> None:
    watched = Watched()
    watched.walk(10)
    watched.now_s -= 0.15
    (track,) = watched.see(legs(3.0, -0.5, 0.0))
    assert track.track_id == 0


@pytest.mark.parametrize(
    ("circles", "expected"),
    [
        ([], _sight_kernels.EMPTY),
        ([(1.5, 0.0, 0.3)], _sight_kernels.OCCLUDED),
        ([(3.0, 0.0, 0.2)], _sight_kernels.PRESENT),
    ],
)
def test_what_the_laser_sees_at_a_place(circles: list[tuple[float, float, float]], expected: int) -> None:
    view = view_of(circles)
    places = np.array([[3.0, 0.0, 0.0, 0.0], [-3.0, 0.0, 0.0, 0.0]])
    sight = np.empty(2, dtype=np.int64)
    for ranges, is_valid in ((view.ranges, view.is_valid), (np.full_like(view.ranges, 20.0), ~view.is_valid)):
        _sight_kernels.sight_at(
            places,
            view.T_local_laser,
            view.angle_min,
            view.angle_increment,
            ranges,
            is_valid,
            15.0,
            0.25,
            sight,
        )
        # nothing returned at all: seen through as well
        assert sight.tolist() == [
            expected if is_valid.all() else _sight_kernels.EMPTY,
            _sight_kernels.OUT_OF_VIEW,
        ]
