"""Simulated laser scanners: exact ray casting, then the errors that real ones make."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.simulation import _ray_kernels

HIT_NOTHING = -2
HIT_STATIC = -1

_CHUNK_SCANS = 256
"""Scans per block of random draws: part of what a seed means, so it is fixed."""


@dataclass(frozen=True, kw_only=True)
class SimulatedLaser:
    """A scanner's geometry and its errors.

    Attributes
    ----------
    name : str
    model : LaserModel
        Beams, limits and mounting.
    rate_hz : float
        Scans per second, within `rate_limits_hz`.
    rate_limits_hz : (float, float)
    noise_std_m : float
        Standard deviation of the Gaussian range noise [m].
    resolution_m : float
        Ranges are multiples of this [m]; 0 for no rounding.
    dropout_probability : float
        Share of beams that return nothing.
    mixed_probability : float
        Share of beams whose footprint is looked at in two places; at an edge they return a range between.
    footprint_rad : float
        Width of a beam [rad].
    max_mixed_gap_m : float
        Surfaces further apart than this are told apart: the nearer one returns [m].
    no_return_m : float
        What a beam without a return reads [m]; `range_max` or infinity.
    sweep : float
        Share of the time from scan to scan in which its beams are sent out one after the other; 0: a snapshot, all
        beams share one stamp and pose.
    """

    name: str
    model: LaserModel
    rate_hz: float
    rate_limits_hz: tuple[float, float] = (0.1, 1000.0)
    noise_std_m: float = 0.01
    resolution_m: float = 0.001
    dropout_probability: float = 0.0
    mixed_probability: float = 0.0
    footprint_rad: float = 0.0
    max_mixed_gap_m: float = 1.5
    no_return_m: float = float("inf")
    sweep: float = 0.0

    def __post_init__(self) -> None:
        low, high = self.rate_limits_hz
        if not low <= self.rate_hz <= high:
            raise ConfigError(
                f"{self.name}: rate_hz must lie between {low:g} and {high:g}, not {self.rate_hz:g}"
            )
        for key in ("noise_std_m", "resolution_m", "footprint_rad", "max_mixed_gap_m"):
            value = getattr(self, key)
            if not 0.0 <= value < np.inf:
                raise ConfigError(f"{self.name}: {key} must be zero or positive, not {value:g}")
        for key in ("dropout_probability", "mixed_probability", "sweep"):
            value = getattr(self, key)
            if not 0.0 <= value <= 1.0:
                raise ConfigError(f"{self.name}: {key} must lie between 0 and 1, not {value:g}")
        if not self.no_return_m >= self.model.range_max:
            raise ConfigError(
                f"{self.name}: no_return_m must not be below range_max {self.model.range_max:g}, "
                f"not {self.no_return_m:g}"
            )

    def at_rate(self, rate_hz: float) -> "SimulatedLaser":
        """Return the same scanner at another rate [Hz]; ConfigError outside its limits."""
        return replace(self, rate_hz=rate_hz)

    @property
    def time_increment_s(self) -> float:
        """Time between two beams [s]; 0 for a snapshot."""
        return self.sweep / (self.rate_hz * self.model.n_beams)

    @property
    def beam_times(self) -> FloatArray:
        """(n_beams,) times since the stamp [s]."""
        return self.time_increment_s * np.arange(self.model.n_beams, dtype=np.float64)


LMS200 = SimulatedLaser(
    name="lms200",
    model=LaserModel(
        angle_min=-np.pi / 2.0, angle_increment=np.pi / 180.0, n_beams=181, range_min=0.05, range_max=30.0
    ),
    rate_hz=10.0,
    rate_limits_hz=(5.0, 75.0),
    noise_std_m=0.010,
    resolution_m=0.001,
    dropout_probability=0.001,
    mixed_probability=0.3,
    footprint_rad=0.012,
    no_return_m=30.0,
)
"""SICK LMS200: 181 beams over 180 degrees, 5 to 75 Hz, 30 m; a beam without a return reads 30 m."""

UTM30LX = SimulatedLaser(
    name="utm30lx",
    model=LaserModel(
        angle_min=-0.75 * np.pi,
        angle_increment=np.pi / 720.0,
        n_beams=1081,
        range_min=0.1,
        range_max=30.0,
        T_base_laser=(0.1, 0.0, 0.0),
    ),
    rate_hz=40.0,
    rate_limits_hz=(1.0, 40.0),
    noise_std_m=0.010,
    resolution_m=0.001,
    dropout_probability=0.002,
    mixed_probability=0.3,
    footprint_rad=0.006,
)
"""Hokuyo UTM-30LX: 1,081 beams over 270 degrees, 40 Hz, 30 m, 0.1 m ahead of the base."""

LOWCOST360 = SimulatedLaser(
    name="lowcost360",
    model=LaserModel(
        angle_min=-np.pi, angle_increment=np.pi / 180.0, n_beams=360, range_min=0.15, range_max=12.0
    ),
    rate_hz=8.0,
    rate_limits_hz=(1.0, 15.0),
    noise_std_m=0.020,
    resolution_m=0.001,
    dropout_probability=0.03,
    mixed_probability=0.5,
    footprint_rad=0.015,
)
"""A low-cost scanner: 360 beams all round, 8 Hz, 12 m, noisy, with more drop-outs."""

LASERS: Mapping[str, SimulatedLaser] = MappingProxyType(
    {laser.name: laser for laser in (LMS200, UTM30LX, LOWCOST360)}
)


def laser_named(name: str) -> SimulatedLaser:
    """Return the preset of that name; ConfigError lists the known ones."""
    if name not in LASERS:
        raise ConfigError(f"unknown laser {name!r}; known: {', '.join(LASERS)}")
    return LASERS[name]


def cast_rays(
    T_world_laser: FloatArray, model: LaserModel, segments: FloatArray, circles: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Cast every beam of every scan against segments and circles, exactly and without noise.

    Parameters
    ----------
    T_world_laser : (n, 3) array
        The laser in the world, one pose per scan.
    model : LaserModel
        Beams and `range_max`; the mounting is not looked at.
    segments : (m, 4) array
        x1, y1, x2, y2 [m], world frame.
    circles : (n, c, 3) array
        x, y, radius [m] of each circle at each scan, world frame; NaN where there is none.

    Returns
    -------
    ranges : (n, n_beams) array
        To the first surface [m] (from inside a circle, its far side); infinite beyond `range_max`.
    hits : (n, n_beams) int array
        Index of the circle hit, `HIT_STATIC` for a segment, `HIT_NOTHING`.
    """
    n_beams, increment, angle_min = model.n_beams, model.angle_increment, model.angle_min
    if increment < 0.0:
        angle_min, increment = angle_min + (n_beams - 1) * increment, -increment
    ranges = np.full((len(T_world_laser), n_beams), np.inf)
    hits = np.full((len(T_world_laser), n_beams), HIT_NOTHING, dtype=np.int64)
    _ray_kernels.cast(
        np.ascontiguousarray(T_world_laser, dtype=np.float64),
        angle_min,
        increment,
        model.range_max,
        np.ascontiguousarray(segments, dtype=np.float64),
        np.ascontiguousarray(circles, dtype=np.float64),
        ranges,
        hits,
    )
    if model.angle_increment < 0.0:
        return ranges[:, ::-1].copy(), hits[:, ::-1].copy()
    return ranges, hits


def cast_sweeps(
    T_world_laser: FloatArray, model: LaserModel, segments: FloatArray, circles: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Cast each beam of sweeps from its own pose; as `cast_rays`, but for the poses and circles.

    Parameters
    ----------
    T_world_laser : (n, n_beams, 3) array
        The laser in the world, one pose per beam.
    circles : (n, t, c, 3) array
        At t >= 2 times, evenly spaced from the first beam to the last.
    """
    n, n_beams = T_world_laser.shape[:2]
    at = np.linspace(0.0, circles.shape[1] - 1, n_beams)
    before = np.minimum(at.astype(np.int64), circles.shape[1] - 2)
    share = (at - before)[:, None, None]
    of_beams = (1.0 - share) * circles[:, before] + share * circles[:, before + 1]
    poses = T_world_laser.copy()
    poses[..., 2] += model.angle_min + model.angle_increment * np.arange(n_beams)
    one_beam = replace(model, angle_min=0.0, angle_increment=1.0, n_beams=1)
    ranges, hits = cast_rays(
        poses.reshape(-1, 3), one_beam, segments, of_beams.reshape(n * n_beams, circles.shape[2], 3)
    )
    return ranges.reshape(n, n_beams), hits.reshape(n, n_beams)


def measure(
    T_world_base: FloatArray,
    laser: SimulatedLaser,
    segments: FloatArray,
    circles: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, IntArray]:
    """Scan a world with all the scanner's errors.

    The random draws depend on neither the world nor the circles, so a beam that no circle has a part in reads
    the same with and without them.

    Parameters
    ----------
    T_world_base : (n, 3) or (n, n_beams, 3) array
        The robot's base in the world, one pose per scan, or of a sweep one per beam.
    laser : SimulatedLaser
    segments : (m, 4) array [m]
    circles : (n, c, 3) or (n, t, c, 3) array [m]
        Of a sweep at t >= 2 times, evenly spaced from the first beam to the last.
    rng : numpy.random.Generator

    Returns
    -------
    ranges : (n, n_beams) array [m]
        As the scanner reports them.
    hits : (n, n_beams) int array
        Index of a circle that has a part in the return (also a small one: mixed pixels), `HIT_STATIC`,
        or `HIT_NOTHING` where nothing returned.
    """
    n, n_beams = len(T_world_base), laser.model.n_beams
    T_world_laser = se2.compose(T_world_base, np.array(laser.model.T_base_laser))
    ranges = np.empty((n, n_beams))
    hits = np.empty((n, n_beams), dtype=np.int64)
    cast = cast_rays if T_world_laser.ndim == 2 else cast_sweeps
    for first in range(0, n, _CHUNK_SCANS):
        part = slice(first, min(first + _CHUNK_SCANS, n))
        draws = _Draws(laser, part.stop - part.start, rng)
        exact, hit = cast(T_world_laser[part], laser.model, segments, circles[part])
        if laser.mixed_probability > 0.0 and laser.footprint_rad > 0.0:
            aside = T_world_laser[part].copy()
            aside[..., 2] += draws.aside_rad if aside.ndim == 2 else draws.aside_rad[:, None]
            exact, hit = _mix(laser, draws, exact, hit, *cast(aside, laser.model, segments, circles[part]))
        noisy = exact + laser.noise_std_m * draws.noise
        if laser.resolution_m > 0.0:
            noisy = np.round(noisy / laser.resolution_m) * laser.resolution_m
        is_lost = draws.is_dropped | (hit == HIT_NOTHING)
        is_lost |= (noisy < laser.model.range_min) | (noisy > laser.model.range_max)
        ranges[part] = np.where(is_lost, laser.no_return_m, noisy)
        hits[part] = np.where(is_lost, HIT_NOTHING, hit)
    return ranges, hits


class _Draws:
    """The random numbers of a block of scans: always as many, whatever is seen."""

    def __init__(self, laser: SimulatedLaser, n: int, rng: np.random.Generator) -> None:
        shape = (n, laser.model.n_beams)
        self.noise = rng.standard_normal(shape)
        self.is_dropped = rng.random(shape) < laser.dropout_probability
        self.is_mixed = rng.random(shape) < laser.mixed_probability
        self.weight = rng.random(shape)
        self.aside_rad = laser.footprint_rad * (rng.random(n) - 0.5)


def _mix(
    laser: SimulatedLaser,
    draws: _Draws,
    centre: FloatArray,
    centre_hit: IntArray,
    aside: FloatArray,
    aside_hit: IntArray,
) -> tuple[FloatArray, IntArray]:
    """Blend two places within a beam's footprint: between them if they are near, else the nearer one."""
    with np.errstate(invalid="ignore"):
        is_blend = np.abs(centre - aside) <= laser.max_mixed_gap_m
        between = np.where(is_blend, draws.weight * centre + (1.0 - draws.weight) * aside, 0.0)
    nearer = np.minimum(centre, aside)
    nearer_hit = np.where(aside < centre, aside_hit, centre_hit)
    blend_hit = np.where(centre_hit >= 0, centre_hit, aside_hit)
    mixed = np.where(is_blend, between, nearer)
    mixed_hit = np.where(is_blend, blend_hit, nearer_hit)
    return np.where(draws.is_mixed, mixed, centre), np.where(draws.is_mixed, mixed_hit, centre_hit)
