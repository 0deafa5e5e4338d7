"""Walls that a laser sees badly: glass gives no return but at right angles, a mirror one from elsewhere."""

import math
from dataclasses import dataclass, replace

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.simulation.laser import cast_rays

LEAST_WALL_M = 0.8
"""Shorter segments are neither glass nor mirrors."""

NEAR_M = 0.1
"""A return so near to a segment is from it."""

GLARE_RAD = math.radians(8.0)
"""Glass returns beams that meet it so near to the right angle."""


def choose_walls(segments: FloatArray, share: float, rng: np.random.Generator) -> FloatArray:
    """Choose a share of the segments (m, 4) that are long enough."""
    if not 0.0 <= share <= 1.0:
        raise ConfigError(f"the share of the walls must be within 0 to 1, not {share}")
    is_long = np.hypot(*(segments[:, 2:] - segments[:, :2]).T) >= LEAST_WALL_M
    return np.asarray(segments[is_long & (rng.random(len(segments)) < share)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Surfaces:
    """What is glass and what is a mirror in a world.

    Attributes
    ----------
    segments : (m, 4) array [m]
        All walls: what a mirror shows.
    glass, mirrors : (k, 4) arrays [m]
        Those of them that are so.
    """

    segments: FloatArray
    glass: FloatArray
    mirrors: FloatArray

    def seen(
        self,
        ranges: FloatArray,
        hits: IntArray,
        T_world_laser: FloatArray,
        model: LaserModel,
        no_return_m: float,
    ) -> FloatArray:
        """Give the ranges (n, n_beams) of scans that were taken at once, which see the walls as ordinary ones.

        Parameters
        ----------
        ranges : (n, n_beams) array [m]
        hits : (n, n_beams) int array
            Below zero for beams that no person has a part in; the others stay.
        T_world_laser : (n, 3) array
        model : LaserModel
        no_return_m : float
            What a beam without a return reads.
        """
        angles = T_world_laser[:, 2:] + model.angle_min + model.angle_increment * np.arange(model.n_beams)
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        is_wall = np.isfinite(ranges) & (ranges < model.range_max) & (hits < 0)
        ends = T_world_laser[:, None, :2] + np.where(is_wall, ranges, 0.0)[..., None] * directions
        out = ranges.copy()
        for segment in self.glass:
            is_met, normal = _meets(ends, is_wall, segment)
            is_square = np.abs(directions @ normal) > math.cos(GLARE_RAD)
            out[is_met & ~is_square] = no_return_m
        for segment in self.mirrors:
            is_met, normal = _meets(ends, is_wall, segment)
            incoming = directions[is_met]
            outgoing = incoming - 2.0 * (incoming @ normal)[:, None] * normal
            start = ends[is_met] - 2.0 * NEAR_M * incoming
            poses = np.column_stack([start, np.arctan2(outgoing[:, 1], outgoing[:, 0])])
            one_beam = replace(model, angle_min=0.0, angle_increment=1.0, n_beams=1)
            seen, _ = cast_rays(poses, one_beam, self.segments, np.empty((len(poses), 0, 3)))
            total = ranges[is_met] + seen[:, 0]
            out[is_met] = np.where(total <= model.range_max, total, no_return_m)
        return out


def _meets(ends: FloatArray, is_wall: BoolArray, segment: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Beams (n, n_beams) that end on a segment (4,), and its normal (2,)."""
    along = segment[2:] - segment[:2]
    length = float(np.hypot(*along))
    along = along / length
    normal = np.array([-along[1], along[0]])
    apart = ends - segment[:2]
    at = apart @ along
    return is_wall & (np.abs(apart @ normal) < NEAR_M) & (at > 0.0) & (at < length), normal
