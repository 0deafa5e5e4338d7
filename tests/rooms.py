"""A little world for tests of matches and whole runs: walls as segments, persons as discs, rays cast in NumPy."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.scan import LaserModel, Scan, ScanTruth
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.logs.source import SkippedScan
from slammot_graph.methods import get_method
from slammot_graph.pipeline_config import PipelineConfig

LASER = LaserModel(
    angle_min=-np.deg2rad(135.0),
    angle_increment=np.deg2rad(1.5),
    n_beams=181,
    range_min=0.05,
    range_max=30.0,
    T_base_laser=(0.1, 0.0, 0.0),
)


def odometry_of(scan: Scan) -> FloatArray:
    """(3,) odometry of a scan that has some."""
    assert scan.T_odom_base is not None
    return scan.T_odom_base


def box(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """The four walls of a box, rows of (ax, ay, bx, by)."""
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


ROOM = np.vstack([box(-6, -4, 6, 4.5), box(-5, -3, -4, -1), box(4.2, 2, 5, 3), box(-0.5, -0.5, 0.3, 0.4)])
HALL = np.vstack([box(-9, -10, 12, 11), box(7, -6, 8, 4), box(-6, 6, 3, 7)])
CORRIDOR = np.array([[-200.0, -1.0, 200.0, -1.0], [-200.0, 1.0, 200.0, 1.0]])


def cast(
    origin: FloatArray, angles: FloatArray, walls: FloatArray, discs: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Ranges of rays to walls (k, 4) and discs (d, 3) of x, y, radius; which disc, or -1. No hit: infinite."""
    u = np.column_stack([np.cos(angles), np.sin(angles)])[:, None, :]
    a, e = walls[None, :, :2] - origin, walls[None, :, 2:] - walls[None, :, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        det = u[..., 0] * e[..., 1] - u[..., 1] * e[..., 0]
        r = (a[..., 0] * e[..., 1] - a[..., 1] * e[..., 0]) / det
        t = (a[..., 0] * u[..., 1] - a[..., 1] * u[..., 0]) / det
        ranges = np.where((r > 0.0) & (t >= 0.0) & (t <= 1.0), r, np.inf).min(axis=1)
    ids = np.full(len(angles), -1)
    for number, (x, y, radius) in enumerate(discs):
        along = u[:, 0, 0] * (x - origin[0]) + u[:, 0, 1] * (y - origin[1])
        aside2 = (x - origin[0]) ** 2 + (y - origin[1]) ** 2 - along**2
        hit = (along > 0.0) & (aside2 < radius**2)
        r_disc = np.where(hit, along - np.sqrt(np.maximum(radius**2 - aside2, 0.0)), np.inf)
        ids = np.where(r_disc < ranges, number, ids)
        ranges = np.minimum(ranges, r_disc)
    return ranges, ids


def wall_distance(points: FloatArray, walls: FloatArray) -> FloatArray:
    """(...) distance [m] of points (..., 2) to the nearest of walls (k, 4)."""
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    offset = points[..., None, :] - a
    share = np.clip(np.sum(offset * e, axis=-1) / np.maximum(np.sum(e * e, axis=-1), 1e-12), 0.0, 1.0)
    distance_m: FloatArray = np.linalg.norm(offset - share[..., None] * e, axis=-1).min(axis=-1)
    return distance_m


def is_person(scan: Scan) -> BoolArray:
    """(n,) the beams that truly hit somebody."""
    assert scan.truth is not None
    assert scan.truth.is_moving is not None
    return scan.truth.is_moving


def take_scan(
    T_world_base: FloatArray,
    *,
    index: int = 0,
    walls: FloatArray = ROOM,
    discs: Sequence[Sequence[float]] = (),
    T_odom_base: FloatArray | None = None,
    noise: FloatArray | None = None,
    laser: LaserModel = LASER,
) -> Scan:
    """One scan with its truth; `noise` (beams,) is added to the ranges."""
    T_world_laser = se2.compose(T_world_base, np.array(laser.T_base_laser))
    angles = T_world_base[2] + laser.angles_base
    ranges, ids = cast(T_world_laser[:2], angles, walls, np.array(discs, dtype=np.float64).reshape(-1, 3))
    return Scan(
        index=index,
        stamp=100.0 + 0.1 * index,
        ranges=ranges if noise is None else ranges + noise,
        laser=laser,
        T_odom_base=T_world_base if T_odom_base is None else T_odom_base,
        truth=ScanTruth(T_world_base=T_world_base, is_moving=ids >= 0, object_id=ids),
    )


@dataclass
class ListLog:
    """Scans in memory as a `LaserLog`."""

    scans: list[Scan]
    path: Path = Path("list.log")
    skipped: list[SkippedScan] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def n_scans(self) -> int:
        return len(self.scans) + len(self.skipped)

    def __iter__(self) -> Iterator[Scan]:
        return iter(self.scans)


def drive(
    n: int, *, seed: int = 0, walls: FloatArray = ROOM, is_straight: bool = False, with_person: bool = True
) -> ListLog:
    """A robot on a circle of 2 m (or straight on) while a person walks to and fro, with noise on all."""
    rng = np.random.default_rng(seed)
    step = np.array([0.08, 0.0, 0.0 if is_straight else 0.04])
    T_world_base = np.zeros(3) if is_straight else np.array([2.0, 0.0, np.pi / 2])
    T_odom_base = np.array([1.0, -2.0, 0.3])
    scans = []
    for k in range(n):
        person = [3.0 * np.sin(0.035 * k - 1.0), 3.2, 0.25]
        scan = take_scan(
            T_world_base,
            index=k,
            walls=walls,
            discs=[person] if with_person else [],
            T_odom_base=T_odom_base,
            noise=rng.normal(0.0, 0.008, LASER.n_beams),
        )
        scans.append(scan)
        error = rng.normal([0.0, 0.0, 0.001], [0.004, 0.002, 0.004])
        T_world_base, T_odom_base = se2.compose(T_world_base, step), se2.compose(T_odom_base, step + error)
    return ListLog(scans)


def occluded(log: ListLog, *indices: int) -> ListLog:
    """The log itself, with the laser occluded in some scans."""
    for k in indices:
        log.scans[k].ranges[:] = np.inf
    return log


def kidnapped(log: ListLog, start: int) -> ListLog:
    """The log itself; from scan `start` on the robot is in the hall, where nothing is like the room."""
    for scan in log.scans[start:]:
        assert scan.truth is not None
        assert scan.truth.T_world_base is not None
        scan.ranges[:] = take_scan(scan.truth.T_world_base, walls=HALL).ranges
    return log


def pipeline_config(method: str) -> PipelineConfig:
    """The configuration of a method that is no baseline."""
    config = get_method(method).config
    assert isinstance(config, PipelineConfig)
    return config


def truth_from_start(log: ListLog) -> FloatArray:
    """(n, 3) true poses in the frame of the first one."""
    poses = np.array([scan.truth.T_world_base for scan in log.scans if scan.truth is not None])
    return se2.between(poses[0], poses)


def errors(T_a: FloatArray, T_b: FloatArray) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between two trajectories (n, 3)."""
    apart = se2.between(T_a, T_b).reshape(-1, 3)
    return float(np.hypot(apart[:, 0], apart[:, 1]).max()), float(np.abs(apart[:, 2]).max())
