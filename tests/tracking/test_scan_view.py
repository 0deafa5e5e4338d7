import math

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.tracking import _sight_kernels as sight
from slammot_graph.tracking.base import EDGE_STD_M, ScanView

N = 181
LASER = LaserModel(
    angle_min=-1.5,
    angle_increment=3.0 / (N - 1),
    n_beams=N,
    range_min=0.0,
    range_max=20.0,
    T_base_laser=(0.2, 0.1, 0.3),
)
T_LOCAL_BASE = np.array([1.0, -2.0, 0.7])
TIMES = np.linspace(0.0, 0.18, N)
VELOCITY = np.array([0.8, 0.0, 1.5])
WALL_M = 6.0


def taken(velocity: FloatArray, person: FloatArray, radius_m: float = 0.2) -> Scan:
    """A sweep while the base moves, from the pose 0 at the stamp: a person before a round wall far away."""
    motion = SweepMotion(
        first_s=0.0,
        last_s=float(TIMES[-1]),
        T_stamp_base=se2.exp(np.linspace(0.0, float(TIMES[-1]), 9)[:, None] * velocity),
        cov_velocity=np.zeros((3, 3)),
    )
    poses = motion.at(TIMES)
    T = se2.compose(poses, np.array(LASER.T_base_laser))
    bearing = np.arctan2(*(person - T[:, :2]).T[::-1]) - T[:, 2] - LASER.angle_min
    beam_off = np.remainder(bearing + math.pi, 2 * math.pi) - math.pi
    off = np.abs(beam_off - LASER.angle_increment * np.arange(N))
    distance = np.hypot(*(person - T[:, :2]).T)
    hits = off < np.arctan2(radius_m, distance)
    return Scan(
        index=0,
        stamp=0.0,
        ranges=np.where(hits, distance - 0.05, WALL_M),
        laser=LASER,
        T_odom_base=None,
        beam_times=TIMES,
        sweep=motion,
    )


def sight_of(scan: Scan, place_base: FloatArray) -> int:
    view = ScanView.of_scan(
        scan,
        T_LOCAL_BASE,
        scan.points(T_LOCAL_BASE),
        packed_cov=np.zeros((N, 3)),
        cluster=np.full(N, -1),
        is_proven=np.zeros(N, dtype=bool),
        is_valid=np.full(N, True),
        range_fraction=0.97,
    )
    place = se2.transform(T_LOCAL_BASE, place_base[None])
    out = np.empty(1, dtype=np.int64)
    sight.sight_at(
        np.column_stack([place, np.zeros((1, 2))]),
        view.T_local_laser,
        view.angle_min,
        view.angle_increment,
        view.ranges,
        view.is_valid,
        view.no_return_m,
        0.1,
        out,
    )
    return int(out[0])


@pytest.mark.parametrize("turn", [-1.5, 0.0, 1.5])
@pytest.mark.parametrize("bearing", [-0.9, 0.2, 1.0])
def test_a_sweep_sees_whom_its_beams_met_and_sees_through_elsewhere(turn: float, bearing: float) -> None:
    place = np.array([0.2, 0.1]) + 3.0 * np.array([math.cos(bearing), math.sin(bearing)])
    scan = taken(VELOCITY * (1.0, 1.0, turn / 1.5), place)
    assert sight_of(scan, place) == sight.PRESENT
    beyond = np.array([0.2, 0.1]) + 4.5 * np.array([math.cos(bearing), math.sin(bearing)])
    assert sight_of(scan, beyond) == sight.OCCLUDED
    for beside in (-0.25, 0.25):
        other = np.array([0.2, 0.1]) + 3.0 * np.array(
            [math.cos(bearing + beside), math.sin(bearing + beside)]
        )
        assert sight_of(scan, other) == sight.EMPTY


def test_the_turn_during_a_sweep_moves_the_edge_of_the_field_of_view() -> None:
    last = LASER.T_base_laser[2] + LASER.angle_min + 3.0
    place = np.array([0.2, 0.1]) + 3.0 * np.array([math.cos(last + 0.12), math.sin(last + 0.12)])
    assert sight_of(taken(np.array([0.0, 0.0, 1.5]), place + 50.0), place) == sight.EMPTY
    assert sight_of(taken(np.array([0.0, 0.0, -1.5]), place + 50.0), place) == sight.OUT_OF_VIEW


def test_a_scan_taken_at_once_is_seen_as_it_is() -> None:
    scan = taken(np.zeros(3), np.array([3.0, 0.0]))
    scan = Scan(index=0, stamp=0.0, ranges=scan.ranges, laser=LASER, T_odom_base=None)
    view = ScanView.of_scan(
        scan,
        T_LOCAL_BASE,
        scan.points(T_LOCAL_BASE),
        packed_cov=np.zeros((N, 3)),
        cluster=np.full(N, -1),
        is_proven=np.zeros(N, dtype=bool),
        is_valid=np.full(N, True),
        range_fraction=0.97,
    )
    assert view.ranges is scan.ranges
    assert view.angle_increment == LASER.angle_increment
    np.testing.assert_array_equal(view.T_local_laser, se2.compose(T_LOCAL_BASE, np.array(LASER.T_base_laser)))


@pytest.mark.parametrize("increment", [0.01, -0.01])
def test_who_is_cut_by_the_edge_of_a_view_is_less_certain_across_the_line_of_sight(increment: float) -> None:
    n = 201
    angles = -increment * 100 + increment * np.arange(n)
    ranges = np.full(n, 2.0)
    cluster = np.where(np.isin(np.arange(n), [1, 2, 100, 199]), 0, -1)
    view = ScanView(
        points=ranges[:, None] * np.column_stack([np.cos(angles + 0.5), np.sin(angles + 0.5)]),
        packed_cov=np.tile([1e-4, 0.0, 1e-4], (n, 1)),
        cluster=cluster,
        is_proven=cluster >= 0,
        T_local_laser=np.array([0.0, 0.0, 0.5]),
        angle_min=float(angles[0]),
        angle_increment=increment,
        ranges=ranges,
        is_valid=np.full(n, True),
        no_return_m=30.0,
    )
    partial = view.by_one_of_several()
    assert partial.is_one_of_several
    changed = np.flatnonzero((partial.packed_cov != view.packed_cov).any(axis=1))
    assert changed.tolist() == [1, 2, 199]
    for k in changed:
        xx, xy, yy = partial.packed_cov[k]
        cov = np.array([[xx, xy], [xy, yy]])
        along = np.array([math.cos(angles[k] + 0.5), math.sin(angles[k] + 0.5)])
        across = np.array([-along[1], along[0]])
        assert along @ cov @ along == pytest.approx(1e-4)
        assert across @ cov @ across == pytest.approx(1e-4 + EDGE_STD_M**2)


def test_a_view_all_around_has_no_edge() -> None:
    n = 360
    view = ScanView(
        points=np.zeros((n, 2)),
        packed_cov=np.full((n, 3), 1e-4),
        cluster=np.zeros(n, dtype=np.int64),
        is_proven=np.full(n, True),
        T_local_laser=np.zeros(3),
        angle_min=-math.pi,
        angle_increment=2.0 * math.pi / n,
        ranges=np.ones(n),
        is_valid=np.full(n, True),
        no_return_m=30.0,
    )
    np.testing.assert_array_equal(view.by_one_of_several().packed_cov, view.packed_cov)
