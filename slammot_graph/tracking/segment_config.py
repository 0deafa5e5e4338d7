"""Configuration of the tracker of people."""

from dataclasses import dataclass, field

import numpy as np

from slammot_graph.core.checks import Checked, Count, NotNegative, Positive
from slammot_graph.core.types import FloatArray
from slammot_graph.tracking.chain import SmoothingConfig


@dataclass(frozen=True, kw_only=True)
class SegmentTrackerConfig(Checked):
    """Motion and measurement noise of the tracks, what belongs to one body, and when tracks begin, show and end.

    Attributes
    ----------
    acceleration_std_m_s2 : float
        White-noise acceleration of a walking person.
    leg_std_m : float
        Of one leg as a measurement of the person's centre.
    body_std_m : float
        The same of both legs, or of a trunk.
    near_std_m : float
        That has in addition what is seen beside another object: a part of that may be among it.
    noise_gain : float
        How fast a track learns the factor on these variances from its innovations.
    start_speed_std_m_s : float
    gate : float
        Largest squared Mahalanobis distance of a segment to a track (9.21: 99% for two dimensions).
    max_jump_m : float
        Nor is a segment farther than this from where a track was predicted.
    segment_gap_m : float
        Neighbouring beams farther apart belong to different segments.
    standing_reach_m, standing_gap_m, standing_speed_m_s, standing_distance_m : float
        Points this near to a slow object that has gone some distance are its own, if nothing else is within the gap
        beside them.
    min_on_free : int
        The same of one that stood on free cells at so many sightings: it was not there before.
    leg_width_m : float
        A wider segment is more than a leg.
    body_m : float
        Segments this near to each other may be one body.
    apart_m : float
        What is nearer than this to an object that is followed begins no track.
    twin_m, max_twin_s : float
        Two tracks nearer than this for this long follow one object: the younger one ends.
    n_confirm : int
        Sightings needed before a track is reported.
    strong_points : int
        A sighting with so many points on free cells counts for two.
    shown_s : float
        A track is reported up to this long after a sighting, unless the laser sees through it.
    max_empty_s : float
        A track ends when the laser has seen through its place for this long.
    max_unproven_s : float
        A track ends when no beam on free cells was among its sightings for this long: what is taken for an object since
        one is expected there must not keep that expectation alive.
    min_unproven_points : int
        A sighting of fewer points, none of them on free cells, is none.
    max_missed_s : float
        A track ends after this long without a sighting, where it is occluded or out of view.
    min_distance_m : float
        An object has displaced once it was this far from where it was first seen.
    smoothing : SmoothingConfig or None
        None: the tracks of the time are the final ones.
    """

    acceleration_std_m_s2: Positive = 1.5
    leg_std_m: Positive = 0.15
    body_std_m: Positive = 0.06
    near_std_m: NotNegative = 0.07
    noise_gain: NotNegative = 0.05
    start_speed_std_m_s: Positive = 1.0
    gate: Positive = 9.21
    max_jump_m: Positive = 1.5
    segment_gap_m: Positive = 0.1
    standing_reach_m: Positive = 0.35
    standing_gap_m: Positive = 0.15
    standing_speed_m_s: Positive = 0.5
    standing_distance_m: Positive = 0.5
    min_on_free: Count = 15
    leg_width_m: Positive = 0.25
    body_m: Positive = 0.5
    apart_m: NotNegative = 0.7
    twin_m: Positive = 0.5
    max_twin_s: Positive = 1.0
    n_confirm: Count = 3
    strong_points: Count = 5
    shown_s: Positive = 0.35
    max_empty_s: Positive = 0.6
    max_unproven_s: Positive = 1.0
    min_unproven_points: Count = 3
    max_missed_s: Positive = 3.0
    min_distance_m: Positive = 1.0
    smoothing: SmoothingConfig | None = field(default_factory=SmoothingConfig)

    def limits(self) -> FloatArray:
        """(27,) what the kernels take, in the order that they name."""
        return np.array(
            [
                self.acceleration_std_m_s2,
                self.leg_std_m**2,
                self.body_std_m**2,
                self.start_speed_std_m_s**2,
                self.gate,
                self.max_jump_m,
                self.segment_gap_m,
                self.standing_reach_m,
                self.standing_gap_m,
                self.standing_speed_m_s,
                self.leg_width_m,
                self.body_m,
                self.apart_m,
                self.twin_m,
                self.max_twin_s,
                self.n_confirm,
                self.shown_s,
                self.max_empty_s,
                self.max_unproven_s,
                self.min_unproven_points,
                self.max_missed_s,
                self.min_distance_m,
                self.standing_distance_m,
                self.min_on_free,
                self.strong_points,
                self.near_std_m**2,
                self.noise_gain,
            ],
            dtype=np.float64,
        )
