"""People who walk, stop, cross and accompany the robot: their paths, and what the laser sees of them."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.simulation.crowds import walk_in_crowd
from slammot_graph.simulation.free_space import FreeSpace

Behaviour = Literal["wander", "walk-then-stop", "along", "crowd"]
Shape = Literal["legs", "cylinder"]

STRIDE_M = 0.7
LEG_RADIUS_M = 0.065
HALF_HIP_M = 0.11


@dataclass(frozen=True, kw_only=True)
class PeopleConfig:
    """How people move and look.

    Attributes
    ----------
    behaviour : "wander" (from goal to goal around the robot, with pauses), "walk-then-stop", "along" or
        "crowd" (by JuPedSim)
    shape : "legs" (two, with a gait) or "cylinder"
    cylinder_radius_m : float
    speed_min_m_s, speed_max_m_s : float
        Each person's walking speed is drawn between these.
    pause_probability : float
        Chance of a pause at a goal.
    pause_min_s, pause_max_s : float
    stop_after_share : float
        "walk-then-stop": share of the log's time after which a person stands for good.
    reach_m : float
        Goals lie within this of the robot; a person farther than 1.5 times that leaves, and comes back nearer.
    keep_off_m : float
        Distance that a person keeps from the robot's centre.
    along_min_m, along_max_m : float
        "along": distance from the robot.
    """

    behaviour: Behaviour = "wander"
    shape: Shape = "legs"
    cylinder_radius_m: float = 0.25
    speed_min_m_s: float = 0.5
    speed_max_m_s: float = 1.4
    pause_probability: float = 0.3
    pause_min_s: float = 1.0
    pause_max_s: float = 8.0
    stop_after_share: float = 0.55
    reach_m: float = 6.0
    keep_off_m: float = 0.75
    along_min_m: float = 0.8
    along_max_m: float = 2.4

    def __post_init__(self) -> None:
        for name, kind in (("behaviour", Behaviour), ("shape", Shape)):
            if getattr(self, name) not in get_args(kind):
                raise ConfigError(
                    f'people.{name} must be one of {get_args(kind)}, not "{getattr(self, name)}"'
                )
        if not 0.0 < self.speed_min_m_s <= self.speed_max_m_s:
            raise ConfigError("people need 0 < speed_min_m_s <= speed_max_m_s")
        if not 0.0 <= self.pause_min_s <= self.pause_max_s:
            raise ConfigError("people need 0 <= pause_min_s <= pause_max_s")
        for name in ("pause_probability", "stop_after_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"people.{name} must be in [0, 1], not {getattr(self, name)}")
        for name in ("cylinder_radius_m", "reach_m", "keep_off_m"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"people.{name} must be positive, not {getattr(self, name)}")
        if not 0.0 < self.along_min_m <= self.along_max_m:
            raise ConfigError("people need 0 < along_min_m <= along_max_m")


def walk(
    free_space: FreeSpace,
    stamps: FloatArray,
    T_world_base: FloatArray,
    n_people: int,
    config: PeopleConfig,
    rng: np.random.Generator,
) -> FloatArray:
    """Let people walk about while the robot drives.

    Parameters
    ----------
    free_space : FreeSpace
    stamps : (n,) array [s]
    T_world_base : (n, 3) array
        The robot, which they keep clear of.
    n_people : int
    config : PeopleConfig
    rng : numpy.random.Generator
        Each person has a stream of its own, so that the first ones walk alike however many there are.

    Returns
    -------
    (n, n_people, 4) array
        x, y [m], vx, vy [m/s], world frame; NaN while a person is away.

    Raises
    ------
    ConfigError
        A negative number of people.
    """
    if n_people < 0:
        raise ConfigError(f"the number of people must not be negative, not {n_people}")
    if config.behaviour == "crowd" and n_people > 0:
        speeds_m_s = (config.speed_min_m_s, config.speed_max_m_s)
        return walk_in_crowd(free_space, stamps, T_world_base, n_people, speeds_m_s, config.keep_off_m, rng)
    out = np.full((len(stamps), n_people, 4), np.nan)
    for p, stream in enumerate(rng.spawn(n_people)):
        if config.behaviour == "along":
            out[:, p] = _along(stamps, T_world_base, config, stream)
        else:
            out[:, p] = _Walker(free_space, config, stream).path(stamps, T_world_base)
    return out


def circles(people: FloatArray, stamps: FloatArray, config: PeopleConfig) -> tuple[FloatArray, IntArray]:
    """Turn people into the circles that the laser meets.

    Parameters
    ----------
    people : (n, p, 4) array
        x, y, vx, vy as from `walk`.
    stamps : (n,) array [s]

    Returns
    -------
    circles : (n, c, 3) array
        x, y, radius [m]; NaN while a person is away.
    person : (c,) int array
        Whose circle it is.
    """
    n, n_people, _ = people.shape
    if config.shape == "cylinder":
        radius = np.full((n, n_people, 1), config.cylinder_radius_m)
        return np.concatenate([people[:, :, :2], radius], axis=2), np.arange(n_people)
    heading = _headings(people)
    speed = np.hypot(people[:, :, 2], people[:, :, 3])
    dt = np.diff(stamps, prepend=stamps[:1]).clip(0.0, 1.0)
    phase = np.pi * np.cumsum(np.nan_to_num(speed) * dt[:, None], axis=0) / STRIDE_M
    swing = 0.5 * STRIDE_M * 0.6 * np.sin(phase) * np.clip(speed / 0.5, 0.0, 1.0)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    aside = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    legs = [
        people[:, :, :2] + side * (HALF_HIP_M * aside + swing[:, :, None] * ahead) for side in (-1.0, 1.0)
    ]
    radius = np.full((n, n_people, 1), LEG_RADIUS_M)
    both = [np.concatenate([leg, radius], axis=2) for leg in legs]
    return np.concatenate(both, axis=1), np.tile(np.arange(n_people), 2)


def _headings(people: FloatArray) -> FloatArray:
    """(n, p) walking direction [rad]; while a person stands, the last one."""
    heading = np.zeros(people.shape[:2])
    last = np.zeros(people.shape[1])
    for k in range(len(people)):
        moving = np.hypot(people[k, :, 2], people[k, :, 3]) > 0.05
        last = np.where(moving, np.arctan2(people[k, :, 3], people[k, :, 2]), last)
        heading[k] = last
    return heading


def _along(
    stamps: FloatArray, T_world_base: FloatArray, config: PeopleConfig, rng: np.random.Generator
) -> FloatArray:
    """Keep a place beside the robot, swaying a little."""
    distance_m = rng.uniform(config.along_min_m, config.along_max_m)
    bearing = rng.uniform(-0.5 * np.pi, 0.5 * np.pi)
    phase, period_s = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(3.0, 8.0, 2)
    sway = 0.08 * np.sin(2.0 * np.pi * stamps[:, None] / period_s + phase)
    place = distance_m * np.array([np.cos(bearing), np.sin(bearing)]) + sway
    position = se2.transform(T_world_base, place[:, None, :])[:, 0]
    dt = np.gradient(stamps) if len(stamps) > 1 else np.ones(1)
    velocity = (
        np.gradient(position, axis=0) / np.maximum(dt, 1e-3)[:, None] if len(stamps) > 1 else 0 * position
    )
    return np.concatenate([position, velocity], axis=1)


class _Walker:
    """One person who walks from goal to goal."""

    def __init__(self, free_space: FreeSpace, config: PeopleConfig, rng: np.random.Generator) -> None:
        self.space = free_space
        self.config = config
        self.rng = rng
        self.speed = rng.uniform(config.speed_min_m_s, config.speed_max_m_s)
        self.path_to_goal: IntArray | None = None
        self.goal: FloatArray | None = None
        self.pause_until_s = -np.inf
        self.away_until_s = -np.inf

    def path(self, stamps: FloatArray, T_world_base: FloatArray) -> FloatArray:
        """(n, 4) x, y, vx, vy at each scan."""
        out = np.full((len(stamps), 4), np.nan)
        stop_s = stamps[0] + self.config.stop_after_share * (stamps[-1] - stamps[0])
        is_final = self.config.behaviour == "walk-then-stop"
        position = self._spot(T_world_base[0, :2])
        velocity = np.zeros(2)
        for k, stamp in enumerate(stamps):
            robot = T_world_base[k, :2]
            dt = float(np.clip(stamp - stamps[k - 1], 0.0, 1.0)) if k else 0.0
            stands = is_final and stamp >= stop_s
            if position is None:
                position = self._spot(robot) if stamp >= self.away_until_s else None
                velocity = np.zeros(2)
                self.goal = None
                continue
            if not stands and np.hypot(*(position - robot)) > 1.5 * self.config.reach_m:
                position, self.away_until_s = None, stamp + self.rng.uniform(1.0, 4.0)
                continue
            wanted = np.zeros(2) if stands else self._wanted(position, robot, stamp)
            velocity = velocity + np.clip(dt / 0.3, 0.0, 1.0) * (wanted - velocity)
            velocity = self._avoid(position, velocity, robot, dt)
            moved = position + velocity * dt
            if self.space.clearance_at(moved) < 0.8 * self.space.person_radius_m:
                velocity, moved, self.goal = np.zeros(2), position, None
            position = moved
            out[k] = *position, *velocity
        return out

    def _spot(self, robot: FloatArray) -> FloatArray | None:
        """Pick a place to appear, in reach of the robot but not on top of it."""
        points = self.space.walkable_points
        distance = np.hypot(*(points - robot).T)
        near = np.flatnonzero((distance > 2.0) & (distance < self.config.reach_m))
        return points[self.rng.choice(near)].copy() if len(near) else None

    def _wanted(self, position: FloatArray, robot: FloatArray, stamp: float) -> FloatArray:
        """Velocity towards the next point of the path; picks a new goal where there is none."""
        if stamp < self.pause_until_s:
            return np.zeros(2)
        if self.goal is not None and np.hypot(*(self.goal - position)) < 0.3:
            self.goal = None
            if self.rng.random() < self.config.pause_probability:
                self.pause_until_s = stamp + self.rng.uniform(
                    self.config.pause_min_s, self.config.pause_max_s
                )
                return np.zeros(2)
        if self.goal is None:
            points = self.space.walkable_points
            near = np.flatnonzero(np.hypot(*(points - robot).T) < self.config.reach_m)
            if not len(near):
                return np.zeros(2)
            self.goal = points[self.rng.choice(near)].copy()
            self.path_to_goal = self.space.path_to(self.goal, position)
        assert self.path_to_goal is not None
        ahead = self.space.ahead(self.path_to_goal, position, 0.4)
        if ahead is None:
            self.goal = None
            return np.zeros(2)
        offset = ahead - position
        return self.speed * offset / max(float(np.hypot(*offset)), 0.1)

    def _avoid(self, position: FloatArray, velocity: FloatArray, robot: FloatArray, dt: float) -> FloatArray:
        """Do not walk into the robot, and give way to it."""
        offset = position + velocity * dt - robot
        distance = float(np.hypot(*offset))
        if distance >= self.config.keep_off_m or dt == 0.0:
            return velocity
        out = offset / max(distance, 1e-6)
        inward = min(float(velocity @ out), 0.0)
        self.goal = None
        return velocity - inward * out + 0.8 * out
