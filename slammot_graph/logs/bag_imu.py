"""Yaw of the base from the messages of an IMU in a bag."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.logs.bag_messages import Bag, frame_name, header_stamp
from slammot_graph.logs.bag_mounting import frame_tree
from slammot_graph.logs.bag_topics import Topic
from slammot_graph.logs.scan_odometry import MAX_TURN_RAD

MAX_GAP_S = 0.5
"""No yaw is told between messages further apart in time."""

MAX_HOLD_S = 0.1
"""How long the yaw is held before the first message and after the last."""


@dataclass(frozen=True, kw_only=True, eq=False)
class YawTrack:
    """Yaw rate integrated over time.

    Attributes
    ----------
    stamps : (n,) array
        Increasing [s].
    yaw : (n,) array
        Not wrapped, 0 at the first stamp [rad].
    """

    stamps: FloatArray
    yaw: FloatArray

    @classmethod
    def from_rates(cls, stamps: FloatArray, yaw_rates: FloatArray) -> "YawTrack":
        """Integrate yaw rates (n,) [rad/s] by the trapezoidal rule; those that are not finite are left out.

        Parameters
        ----------
        stamps, yaw_rates : (n,) arrays
            In any order.
        """
        is_used = np.isfinite(stamps) & (np.abs(yaw_rates) <= MAX_TURN_RAD)
        stamps, first = np.unique(stamps[is_used], return_index=True)
        rates = yaw_rates[is_used][first]
        turns = 0.5 * (rates[:-1] + rates[1:]) * np.diff(stamps)
        return cls(stamps=stamps, yaw=np.concatenate([np.zeros(min(1, len(stamps))), np.cumsum(turns)]))

    def at(self, stamp: float) -> float | None:
        """Yaw at a time [s]; None where the messages leave a gap."""
        after = int(np.searchsorted(self.stamps, stamp))
        if after in (0, len(self.stamps)):
            end = self.stamps[[0, -1]] if len(self.stamps) else np.empty(0)
            if not (np.abs(end - stamp) <= MAX_HOLD_S).any():
                return None
        elif self.stamps[after] - self.stamps[after - 1] > MAX_GAP_S:
            return None
        return float(np.interp(stamp, self.stamps, self.yaw))


def read_yaw(bag: Bag, topic: Topic, base_frames: Sequence[str], *, uses_headers: bool) -> YawTrack:
    """Yaw of the base by an IMU, which may be mounted at any angle that tf tells."""
    stamps, rates, frames = [], [], []
    for message in bag.messages([topic]):
        if message.content is None:
            continue
        rate = message.content.angular_velocity
        stamps.append(header_stamp(message.content) if uses_headers else message.bag_stamp)
        rates.append((rate.x, rate.y, rate.z))
        frames.append(frame_name(message.content.header.frame_id))
    axis = _axis(bag, base_frames, frames[0]) if frames else np.zeros(3)
    return YawTrack.from_rates(np.array(stamps), np.array(rates).reshape(-1, 3) @ axis)


def _axis(bag: Bag, base_frames: Sequence[str], imu_frame: str) -> FloatArray:
    """(3,) the base's upward axis in the frame of the IMU; its own z axis where tf does not tell."""
    tree = frame_tree(bag, base_frames[0], imu_frame)
    for base_frame in base_frames:
        T_base_imu = tree.between(base_frame, imu_frame)
        if T_base_imu is not None:
            return T_base_imu[2, :3]
    return np.array([0.0, 0.0, 1.0])
