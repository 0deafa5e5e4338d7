"""People injected into a real log: they shorten rays, everything else stays as recorded."""

import numpy as np
from scipy import ndimage

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.logs import LaserLog
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.simulation.free_space import MAX_CLEARANCE_M, FreeSpace, connected_free_space
from slammot_graph.simulation.laser import cast_rays, cast_sweeps
from slammot_graph.simulation.log import SimulatedLog
from slammot_graph.simulation.people import PeopleConfig, circles, walk
from slammot_graph.simulation.sweeps import circles_during_sweeps, poses_between

RESOLUTION_M = 0.1
RANGE_STD_M = 0.01
RANGE_STEP_M = 0.01
MAX_ALONG = 60


def inject(
    log: LaserLog,
    T_map_base: FloatArray,
    *,
    n_people: int,
    seed: int,
    people: PeopleConfig | None = None,
    max_scans: int | None = None,
) -> SimulatedLog:
    """Let people walk through a recorded log, on paths that its own scans show to be free.

    Parameters
    ----------
    log : LaserLog
        Of one laser geometry; scans of another are left out.
    T_map_base : (n, 3) array
        Reference trajectory of its scans, such as a run's ``trajectory.tum``.
    n_people : int
    seed : int
    people : PeopleConfig, optional
        Default: people who wander around the robot.
    max_scans : int, optional
        Take the log's first ones only.

    Returns
    -------
    SimulatedLog
        With the reference as its poses and exact labels of the injected beams.

    Raises
    ------
    InputError
        The trajectory does not fit the log.
    ConfigError
        A negative number of people.
    """
    config = people or PeopleConfig()
    if seed < 0:
        raise ConfigError(f"the seed must not be negative, not {seed}")
    if n_people < 0:
        raise ConfigError(f"the number of people must not be negative, not {n_people}")
    base = _Base(log, T_map_base, max_scans)
    rng = np.random.default_rng(seed)
    walkers, noise = rng.spawn(2)
    space = None if config.behaviour == "along" else _seen_free(base.scans, base.T_map_base)
    objects = (
        walk(space, base.stamps, base.T_map_base, n_people, config, walkers)
        if space is not None
        else walk(_NOWHERE, base.stamps, base.T_map_base, n_people, config, walkers)
    )
    return base.with_people(objects, config, noise)


def inject_along(
    log: LaserLog, T_map_base: FloatArray, *, share: float, seed: int, max_scans: int | None = None
) -> SimulatedLog:
    """Let 0.25 m discs walk with the robot until they take the wanted share of its valid beams.

    Parameters
    ----------
    share : float
        Of the beams with a valid return, in [0, 1).

    See `inject` for the others.
    """
    if not 0.0 <= share < 1.0:
        raise ConfigError(f"the share of beams must be in [0, 1), not {share}")
    if seed < 0:
        raise ConfigError(f"the seed must not be negative, not {seed}")
    config = PeopleConfig(behaviour="along", shape="cylinder")
    base = _Base(log, T_map_base, max_scans)
    is_valid = base.ranges < 0.97 * base.laser.range_max
    walkers, noise = np.random.default_rng(seed).spawn(2)
    objects = np.full((len(base.stamps), 0, 4), np.nan)
    for stream in walkers.spawn(MAX_ALONG):
        shapes, _ = base.shapes(objects, config)
        if np.count_nonzero(base.is_shortened(shapes)[0]) >= share * np.count_nonzero(is_valid):
            break
        another = walk(_NOWHERE, base.stamps, base.T_map_base, 1, config, stream)
        objects = np.concatenate([objects, another], axis=1)
    return base.with_people(objects, config, noise)


class _Base:
    """The recorded scans, and their reference trajectory."""

    def __init__(self, log: LaserLog, T_map_base: FloatArray, max_scans: int | None) -> None:
        if max_scans is not None and max_scans < 1:
            raise ConfigError(f"max_scans must be at least 1, not {max_scans}")
        scans: list[Scan] = []
        for scan in log:
            if max_scans is not None and len(scans) == max_scans:
                break
            scans.append(scan)
        n = len(scans)
        if (max_scans is None and len(T_map_base) != n) or len(T_map_base) < n:
            raise InputError(
                f"{log.path}: the reference trajectory has {len(T_map_base)} poses, the log {n} usable scans; "
                "make it with a run of this log"
            )
        if T_map_base.shape[1:] != (3,) or not np.isfinite(T_map_base).all():
            raise InputError(f"{log.path}: the reference trajectory needs finite (n, 3) poses")
        kept = [k for k, scan in enumerate(scans) if scan.laser.n_beams == scans[0].laser.n_beams]
        self.name = f"{log.path.name} with people"
        self.scans = [scans[k] for k in kept]
        self.T_map_base = T_map_base[kept]
        self.laser: LaserModel = self.scans[0].laser
        self.beam_times = self.scans[0].beam_times
        self.stamps = np.array([scan.stamp for scan in self.scans])
        self.ranges = np.array([scan.ranges for scan in self.scans])
        odometry = [scan.T_odom_base for scan in self.scans]
        self.T_odom_base = np.array([np.full(3, np.nan) if pose is None else pose for pose in odometry])

    def shapes(self, objects: FloatArray, config: PeopleConfig) -> tuple[FloatArray, IntArray]:
        """Circles of people (n, p, 4) as `is_shortened` takes them, and whose each is."""
        if self.beam_times is None:
            return circles(objects, self.stamps, config)
        return circles_during_sweeps(objects, self.stamps, self.beam_times, config)

    def is_shortened(self, shapes: FloatArray) -> tuple[BoolArray, FloatArray, IntArray]:
        """Beams that meet a circle before what was recorded, with the distance and the circle."""
        T_base_laser = np.array(self.laser.T_base_laser)
        if self.beam_times is None:
            T_map_laser = se2.compose(self.T_map_base, T_base_laser)
            distance, hit = cast_rays(T_map_laser, self.laser, np.empty((0, 4)), shapes)
        else:
            T_map_laser = se2.compose(
                poses_between(self.T_map_base, self.stamps, self.beam_times), T_base_laser
            )
            distance, hit = cast_sweeps(T_map_laser, self.laser, np.empty((0, 4)), shapes)
        recorded = np.where(np.isfinite(self.ranges) & (self.ranges > 0.0), self.ranges, np.inf)
        return (hit >= 0) & (distance < recorded) & (distance > self.laser.range_min), distance, hit

    def with_people(
        self, objects: FloatArray, config: PeopleConfig, rng: np.random.Generator
    ) -> SimulatedLog:
        shapes, person = self.shapes(objects, config)
        is_moving, distance, hit = self.is_shortened(shapes)
        noisy = distance + RANGE_STD_M * rng.standard_normal(distance.shape)
        with np.errstate(invalid="ignore"):
            noisy = np.maximum(np.round(noisy / RANGE_STEP_M) * RANGE_STEP_M, self.laser.range_min)
            shortened = np.fmin(noisy, np.where(self.ranges > 0.0, self.ranges, np.inf))
        return SimulatedLog(
            name=self.name,
            laser=self.laser,
            stamps=self.stamps,
            ranges=np.where(is_moving, shortened, self.ranges),
            T_odom_base=self.T_odom_base,
            T_world_base=self.T_map_base,
            is_moving=is_moving,
            object_id=np.where(is_moving, person[np.maximum(hit, 0)], -1)
            if len(person)
            else np.full_like(hit, -1),
            objects=objects,
            time_increment_s=0.0 if self.beam_times is None else float(np.mean(np.diff(self.beam_times))),
        )


def _seen_free(scans: list[Scan], T_map_base: FloatArray) -> FreeSpace:
    """Where the log's own scans saw free space and nothing in it."""
    grid = OccupancyGrid(GridConfig(resolution_m=RESOLUTION_M))
    for k, (scan, T) in enumerate(zip(scans, T_map_base, strict=True)):
        is_valid = scan.is_valid(20.0)
        ends = se2.transform(T, np.vstack([scan.laser.origin_base, scan.points_base()]))
        grid.update(k, ends[0], ends[1:], is_valid, is_valid)
    seen = grid.to_map()
    with np.errstate(invalid="ignore"):
        is_free = seen.p_occupied < 0.2
    clearance = ndimage.distance_transform_edt(np.pad(is_free, 1))[1:-1, 1:-1] * RESOLUTION_M
    return connected_free_space(
        np.minimum(clearance, MAX_CLEARANCE_M),
        seen.origin,
        T_map_base[:, :2],
        resolution_m=RESOLUTION_M,
        person_radius_m=0.3,
    )


_NOWHERE = FreeSpace(
    clearance_m=np.zeros((2, 2)),
    resolution_m=RESOLUTION_M,
    origin=np.zeros(2),
    is_walkable=np.zeros((2, 2), dtype=np.bool_),
    person_radius_m=0.3,
)
