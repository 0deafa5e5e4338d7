"""Chains of sightings of one object after the run, and how they are linked and smoothed."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core.checks import Checked, Count, NotNegative, Positive
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.tracking import _smoothing_kernels as _kernels

MIN_SIGHTINGS_OF_JITTER, MAX_STANDING_SCATTER_M, MAX_JITTER = 10, 0.15, 0.33
"""An object that does not stand goes somewhere: of so many sightings that scatter by more than this, no more than this
share is from one to the next (von Neumann's ratio: 1 for places drawn at random). Corners of walls jump about."""


@dataclass(frozen=True, kw_only=True)
class SmoothingConfig(Checked):
    """How tracklets are linked and smoothed after the run.

    Attributes
    ----------
    acceleration_std_m_s2 : float
        White-noise acceleration.
    noise_factor : float
        On the covariances of the sightings, whose errors last for several scans.
    start_speed_std_m_s : float
    min_sightings, min_distance_m, min_standing : int, float, int
        Shorter chains are left out; so are those that never got this far from their start and have fewer sightings
        than the third: legs of chairs that were seen now and then go nowhere.
    max_absence_s : float
        Tracklets farther apart in time are not linked.
    twin_m : float
        A chain that is nearer than this to a longer one most of the time follows the same object.
    gate : float
        Largest squared Mahalanobis distance of a link (13.28: 99% for four dimensions).
    max_gap_std_m : float
        Between two sightings a place that is known less well than this is left out.
    max_gap_s : float
        A chain is followed beyond its ends, through what is not labelled, until nothing was there for this long.
    """

    acceleration_std_m_s2: Positive = 1.5
    noise_factor: Positive = 2.0
    start_speed_std_m_s: Positive = 1.0
    min_sightings: Count = 5
    min_distance_m: NotNegative = 0.5
    min_standing: Count = 15
    max_absence_s: Positive = 3.0
    twin_m: Positive = 0.5
    gate: Positive = 13.28
    max_gap_std_m: Positive = 0.2
    max_gap_s: Positive = 0.5


@dataclass(eq=False)
class Chain:
    """Sightings of one object in the map, in the order of the scans."""

    scans: IntArray
    places: FloatArray
    covs: FloatArray
    sizes: FloatArray
    thickness: FloatArray

    def part(self, rows: slice) -> "Chain":
        """Some of its sightings."""
        return Chain(**{name: value[rows] for name, value in vars(self).items()})

    def is_object(self, config: SmoothingConfig) -> bool:
        """Whether it has enough sightings, for where it went, and does not jump about."""
        n = len(self.scans)
        if n >= MIN_SIGHTINGS_OF_JITTER:
            scatter2 = float(np.square(self.places - self.places.mean(axis=0)).sum(axis=1).mean())
            steps2 = float(np.square(np.diff(self.places, axis=0)).sum(axis=1).mean())
            if scatter2 > MAX_STANDING_SCATTER_M**2 and steps2 > 2.0 * MAX_JITTER * scatter2:
                return False
        away = np.hypot(*(self.places - self.places[0]).T).max()
        return bool(n >= config.min_standing or (n >= config.min_sightings and away >= config.min_distance_m))

    def smoothed(
        self, scans: IntArray, stamps: FloatArray, config: SmoothingConfig
    ) -> tuple[FloatArray, FloatArray]:
        """States (n, 4) and covariances (n, 4, 4) at some scans, the first and last of which are sightings."""
        n = len(scans)
        at = np.searchsorted(scans, self.scans)
        is_seen, places, noise = np.zeros(n, dtype=np.bool_), np.zeros((n, 2)), np.zeros((n, 2, 2))
        is_seen[at], places[at], noise[at] = True, self.places, config.noise_factor * self.covs
        states, covs = np.empty((n, 4)), np.empty((n, 4, 4))
        times = stamps[scans]
        for _ in range(2):
            _kernels.smooth(
                times,
                is_seen,
                places,
                noise,
                config.acceleration_std_m_s2,
                config.start_speed_std_m_s,
                states,
                covs,
            )
            offset = self.places - states[at, :2]
            distance2 = np.einsum("mi,mi->m", offset, np.linalg.solve(noise[at], offset[..., None])[..., 0])
            noise[at] *= np.maximum(1.0, distance2 / 4.0)[:, None, None]
        return states, covs
