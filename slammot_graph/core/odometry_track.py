"""Odometry as a track in time, asked for the pose at a scan's stamp."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray

MAX_HOLD_S = 0.2
"""How long the nearest pose is held for a stamp that has no pose on both sides."""

MAX_GAP_S = 2.0
"""Poses further apart than this in time are not interpolated between."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryTrack:
    """Poses in the order of their stamps, to be made by `from_samples`.

    Attributes
    ----------
    stamps : (n,) array
        Increasing [s].
    T_odom_base : (n, 3) array
        Theta is unwrapped, so that it can be interpolated.
    """

    stamps: FloatArray
    T_odom_base: FloatArray

    @classmethod
    def from_samples(cls, stamps: FloatArray, T_odom_base: FloatArray) -> "OdometryTrack":
        """Make a track of at least one finite sample, in any order; of those with equal stamps the first counts.

        Parameters
        ----------
        stamps : (n,) array [s]
        T_odom_base : (n, 3) array
        """
        stamps, first = np.unique(stamps, return_index=True)
        T_odom_base = T_odom_base[first]
        T_odom_base[:, 2] = np.unwrap(T_odom_base[:, 2])
        return cls(stamps=stamps, T_odom_base=T_odom_base)

    def at(self, stamp: float) -> FloatArray | None:
        """(3,) base in odom at a time [s]: x, y and theta interpolated linearly, theta along the shorter arc.

        Before the first pose, after the last and in gaps longer than `MAX_GAP_S` the nearest pose is held for
        at most `MAX_HOLD_S`; None where there is none as near.
        """
        after = int(np.searchsorted(self.stamps, stamp))
        neighbours = [i for i in (after - 1, after) if 0 <= i < len(self.stamps)]
        if len(neighbours) == 2:
            gap_s = self.stamps[after] - self.stamps[after - 1]
            if gap_s <= MAX_GAP_S:
                share = (stamp - self.stamps[after - 1]) / gap_s
                pose = (1.0 - share) * self.T_odom_base[after - 1] + share * self.T_odom_base[after]
                return _wrapped(pose)
        if neighbours:
            nearest = min(neighbours, key=lambda i: abs(float(self.stamps[i]) - stamp))
            if abs(self.stamps[nearest] - stamp) <= MAX_HOLD_S:
                return _wrapped(self.T_odom_base[nearest])
        return None

    def at_many(self, stamps: FloatArray) -> FloatArray:
        """(n, 3) base in odom at times (n,) [s], each as `at` gives it; a row of NaN where that gives None."""
        after = np.searchsorted(self.stamps, stamps)
        low, high = (after - 1).clip(0), after.clip(max=len(self.stamps) - 1)
        gap_s = self.stamps[high] - self.stamps[low]
        is_between = (gap_s > 0.0) & (gap_s <= MAX_GAP_S)
        share = np.where(is_between, (stamps - self.stamps[low]) / np.where(is_between, gap_s, 1.0), 0.0)[
            :, None
        ]
        poses: FloatArray = (1.0 - share) * self.T_odom_base[low] + share * self.T_odom_base[high]
        to_low, to_high = np.abs(self.stamps[low] - stamps), np.abs(self.stamps[high] - stamps)
        held = np.where((to_low <= to_high)[:, None], self.T_odom_base[low], self.T_odom_base[high])
        poses = np.where(is_between[:, None], poses, held)
        poses[:, 2] = se2.wrap_angle(poses[:, 2])
        poses[~is_between & ~(np.minimum(to_low, to_high) <= MAX_HOLD_S)] = np.nan
        return poses


def _wrapped(pose: FloatArray) -> FloatArray:
    return np.array([pose[0], pose[1], float(se2.wrap_angle(pose[2]))])
