"""Named scenarios: a world, a robot, a laser and people; the same seed gives the same log."""

from dataclasses import dataclass, field, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation.furniture import with_moved_furniture
from slammot_graph.simulation.laser import laser_named, measure
from slammot_graph.simulation.log import SimulatedLog
from slammot_graph.simulation.people import PeopleConfig, circles, walk
from slammot_graph.simulation.robot import (
    DriveConfig,
    OdometryNoise,
    drive,
    poses_per_period,
    simulate_odometry,
)
from slammot_graph.simulation.surfaces import Surfaces, choose_walls
from slammot_graph.simulation.sweeps import beam_poses, circles_during_sweeps
from slammot_graph.simulation.worlds import world_named


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What is simulated.

    Attributes
    ----------
    name : str
    world : str
        As in `worlds`.
    laser : str
        As in `laser`.
    rate_hz : float
        Scans per second.
    n_people : int
    n_laps : int
        How often the robot drives its route.
    sweep : float
        Share of the time between scans in which the beams are sent out one after the other; 0: snapshots.
    glass, mirrors : float
        Shares of the walls that return nothing but at right angles, and that return what they show; of snapshots alone.
    moved : float
        Share of the furniture that stands elsewhere than in the world's plan; where, draws from `moved_seed` alone.
    moved_seed : int
    drive, odometry, people
        Configuration of the parts.
    mountings : tuple of (x, y, theta)
        Of several lasers of the same kind on the base [m, m, rad], who scan in turn at even intervals; empty: one, as
        it is mounted.
    """

    name: str
    world: str
    laser: str = "lms200"
    rate_hz: float = 10.0
    n_people: int = 0
    n_laps: int = 1
    sweep: float = 0.0
    glass: float = 0.0
    mirrors: float = 0.0
    moved: float = 0.0
    moved_seed: int = 0
    drive: DriveConfig = field(default_factory=DriveConfig)
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    people: PeopleConfig = field(default_factory=PeopleConfig)
    mountings: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.n_people < 0:
            raise ConfigError(f"the number of people must not be negative, not {self.n_people}")
        if self.n_laps < 1:
            raise ConfigError(f"n_laps must be at least 1, not {self.n_laps}")


def turning(rate_rad_s: float) -> DriveConfig:
    """Give a drive that turns at up to a rate, and reaches it within 0.3 s."""
    return DriveConfig(max_turn_rad_s=rate_rad_s, max_turn_accel_rad_s2=max(2.0, rate_rad_s / 0.3))


_STOPPING = PeopleConfig(behaviour="walk-then-stop", stop_after_share=0.6)

SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario(name="one-walker", world="lab", n_people=1, people=PeopleConfig(pause_probability=0.1)),
        Scenario(name="two-walkers", world="lab", n_people=2, people=_STOPPING),
        Scenario(name="lab", world="lab", n_people=3, n_laps=2),
        Scenario(name="office", world="office", n_people=4),
        Scenario(name="corridor", world="corridor", n_people=3),
        Scenario(name="hall", world="hall", n_people=6),
        Scenario(name="crowd", world="hall", n_people=20, people=PeopleConfig(behaviour="crowd")),
        Scenario(name="building", world="building", n_people=6),
        Scenario(
            name="fast-turns",
            world="office",
            laser="lowcost360",
            rate_hz=7.0,
            sweep=1.0,
            n_people=2,
            drive=turning(1.5),
        ),
        Scenario(
            name="two-lasers",
            world="hall",
            n_people=6,
            mountings=((0.25, 0.0, 0.0), (-0.25, 0.0, np.pi)),
        ),
    )
}


def scenario_named(name: str) -> Scenario:
    """Look a scenario up; ConfigError lists those that are."""
    if name not in SCENARIOS:
        raise ConfigError(f'no scenario "{name}"; there are {", ".join(SCENARIOS)}')
    return SCENARIOS[name]


def simulate(
    scenario: str | Scenario,
    *,
    seed: int,
    n_people: int | None = None,
    noise_scale: float = 1.0,
    laser: str | None = None,
    rate_hz: float | None = None,
    n_laps: int | None = None,
    sweep: float | None = None,
) -> SimulatedLog:
    """Simulate a scenario.

    The robot's drive, its odometry, the laser's noise and the people draw from streams of their own, so that logs
    of one seed with more or fewer people, or with more or less odometry noise, are otherwise alike. So are those of a
    laser that sweeps and of one that does not: the same drive, and people as they are at the first beams.

    Parameters
    ----------
    scenario : str or Scenario
    seed : int
    n_people, laser, rate_hz, n_laps, sweep : optional
        In place of the scenario's.
    noise_scale : float
        Factor on the odometry's errors.

    Raises
    ------
    ConfigError
        An unknown name, a negative number of people, seed or noise; glass or mirrors seen by a laser that sweeps.
    """
    chosen = scenario_named(scenario) if isinstance(scenario, str) else scenario
    if seed < 0:
        raise ConfigError(f"the seed must not be negative, not {seed}")
    chosen = replace(
        chosen,
        n_people=chosen.n_people if n_people is None else n_people,
        laser=chosen.laser if laser is None else laser,
        rate_hz=chosen.rate_hz if rate_hz is None else rate_hz,
        n_laps=chosen.n_laps if n_laps is None else n_laps,
        sweep=chosen.sweep if sweep is None else sweep,
    )
    if chosen.sweep and (chosen.glass or chosen.mirrors):
        raise ConfigError("glass and mirrors are simulated for lasers that do not sweep: sweep must be 0")
    world = world_named(chosen.world)
    if chosen.moved:
        world, _ = with_moved_furniture(world, chosen.moved, chosen.moved_seed)
    scanner = replace(laser_named(chosen.laser).at_rate(chosen.rate_hz), sweep=chosen.sweep)
    streams = np.random.default_rng(seed).spawn(4)
    n_lasers = max(len(chosen.mountings), 1)
    period_s = 1.0 / (n_lasers * scanner.rate_hz)
    route = _laps(world.route, chosen.n_laps)
    n_dense = poses_per_period(period_s) if chosen.sweep else 1
    dense = drive(route, chosen.drive, period_s, streams[0], is_dense=chosen.sweep > 0.0)
    T_world_base = dense[::n_dense]
    stamps = period_s * np.arange(len(T_world_base), dtype=np.float64)
    T_odom_base, _ = simulate_odometry(T_world_base, chosen.odometry, streams[1], noise_scale=noise_scale)
    objects = walk(world.free_space, stamps, T_world_base, chosen.n_people, chosen.people, streams[2])
    shapes, person = circles(objects, stamps, chosen.people)
    seen_from = T_world_base
    if chosen.sweep:
        seen_from = beam_poses(dense, period_s / n_dense, stamps, scanner.beam_times)
        shapes, person = circles_during_sweeps(objects, stamps, scanner.beam_times, chosen.people)
    scanners = [
        replace(scanner, model=replace(scanner.model, T_base_laser=pose, number=number))
        for number, pose in enumerate(chosen.mountings)
    ] or [scanner]
    ranges = np.empty((len(stamps), scanner.model.n_beams))
    hits = np.empty(ranges.shape, dtype=np.int64)
    for number, (one, rng) in enumerate(
        zip(scanners, [streams[3], *streams[3].spawn(n_lasers - 1)], strict=True)
    ):
        own = slice(number, None, n_lasers)
        ranges[own], hits[own] = measure(seen_from[own], one, world.segments, shapes[own], rng)
        if chosen.glass or chosen.mirrors:
            walls = np.random.default_rng((seed, len(world.segments)))
            T_world_laser = se2.compose(T_world_base[own], np.array(one.model.T_base_laser))
            surfaces = Surfaces(
                segments=world.segments,
                glass=choose_walls(world.segments, chosen.glass, walls),
                mirrors=choose_walls(world.segments, chosen.mirrors, walls),
            )
            ranges[own] = surfaces.seen(ranges[own], hits[own], T_world_laser, one.model, one.no_return_m)
    is_moving = hits >= 0
    object_id = (
        np.where(is_moving, person[np.maximum(hits, 0)], -1) if len(person) else np.full_like(hits, -1)
    )
    return SimulatedLog(
        name=chosen.name,
        laser=scanners[0].model,
        lasers=tuple(one.model for one in scanners),
        stamps=stamps,
        ranges=ranges,
        T_odom_base=T_odom_base,
        T_world_base=T_world_base,
        is_moving=is_moving,
        object_id=object_id,
        objects=objects,
        time_increment_s=scanner.time_increment_s,
    )


def _laps(route: FloatArray, n_laps: int) -> FloatArray:
    """Drive a route several times; one that ends elsewhere is driven back and forth."""
    is_closed = np.hypot(*(route[0] - route[-1])) < 3.0
    laps = [route if is_closed or lap % 2 == 0 else route[::-1] for lap in range(n_laps)]
    return np.concatenate([laps[0], *(lap[1:] for lap in laps[1:])])
