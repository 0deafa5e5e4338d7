"""The laser's mounting on the robot: from the transforms (tf) of a bag, or given."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.log_info import SourceInfo
from slammot_graph.core.types import FloatArray

MAX_TILT = math.radians(10.0)
"""A laser tilted further out of the robot's plane than this is worth a warning."""


FLIP = "flip"
"""After a given pose: the laser is upside down."""


@dataclass(frozen=True, kw_only=True)
class Mounting:
    """The pose of a laser in the robot's base, in the plane.

    Attributes
    ----------
    T_base_laser : (x, y, theta)
    is_upside_down : bool
        The laser's z axis points down: its beams turn clockwise, seen from above.
    tilt : float
        Angle between the planes of laser and robot [rad].
    """

    T_base_laser: tuple[float, float, float]
    is_upside_down: bool = False
    tilt: float = 0.0

    @property
    def is_level(self) -> bool:
        """Whether the laser scans (about) the robot's plane."""
        return self.tilt <= MAX_TILT


class GivenPose(NamedTuple):
    """A laser pose that the user gave: (x, y, theta) [m, m, rad], and whether upside down; None: as tf says."""

    T_base_laser: tuple[float, float, float]
    is_upside_down: bool | None


GivenPoses: TypeAlias = Mapping[str, GivenPose]
"""Given poses by the names of the lasers' frames; the empty name stands for the only laser."""


def given_poses(laser_pose: Sequence[float | str] | None) -> GivenPoses:
    """Read laser poses as a user gives them: ``[FRAME] X Y YAW [flip]``, for each laser one after the other.

    Raises
    ------
    ConfigError
        They are not such numbers and words.
    """
    words = [] if laser_pose is None else [_number_or_word(x) for x in laser_pose]
    found: dict[str, GivenPose] = {}
    while words:
        first = words[0]
        frame = ""
        if isinstance(first, str):
            frame, words = first.lstrip("/"), words[1:]
        pose = [x for x in words[:3] if not isinstance(x, str) and math.isfinite(x)]
        if len(pose) < 3 or frame == FLIP or frame in found:
            said = " ".join(map(str, laser_pose or ()))
            raise ConfigError(
                f"the laser pose must be three finite numbers X Y YAW, with the word {FLIP} after them where the laser"
                f" is upside down, and the frame's name before them where there are several lasers, not {said}"
            )
        words = words[3:]
        is_upside_down = None
        if words and words[0] == FLIP:
            is_upside_down, words = True, words[1:]
        found[frame] = GivenPose((pose[0], pose[1], pose[2]), is_upside_down)
    return found


def _number_or_word(value: float | str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return str(value)


def laser_pose_source(T_base_laser: tuple[float, float, float], told_by: str) -> SourceInfo:
    """Give the pose of a laser (x, y, theta) [m, m, rad] in the base and its origin, for `source_of`."""
    return {"laser_pose": T_base_laser, "laser_pose_from": told_by}


class FrameTree:
    """Frames and the latest transform of each to its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, FloatArray]] = {}

    def add(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Set or renew the transform (4, 4) of a frame to its parent."""
        self._parents[child] = (parent, T_parent_child)

    def between(self, base: str, laser: str) -> FloatArray | None:
        """Transform ``T_base_laser`` (4, 4) along the tree; None where the frames do not connect."""
        T_ancestor_base = dict(self._ancestors(base))
        for ancestor, T_ancestor_laser in self._ancestors(laser):
            if ancestor in T_ancestor_base:
                return np.linalg.inv(T_ancestor_base[ancestor]) @ T_ancestor_laser
        return None

    def _ancestors(self, frame: str) -> Iterator[tuple[str, FloatArray]]:
        """The frame itself, its parent and so on, each with the transform ``T_ancestor_frame``."""
        T_ancestor_frame = np.eye(4)
        seen: set[str] = set()
        ancestor = frame
        while ancestor not in seen:
            seen.add(ancestor)
            yield ancestor, T_ancestor_frame
            if ancestor not in self._parents:
                return
            ancestor, T_parent_child = self._parents[ancestor]
            T_ancestor_frame = T_parent_child @ T_ancestor_frame


def mounting_from_transform(T_base_laser: FloatArray) -> Mounting:
    """Project a transform (4, 4) onto the plane; numbers are rounded to 1e-6 m and rad."""
    x, y = T_base_laser[0, 3], T_base_laser[1, 3]
    theta = math.atan2(T_base_laser[1, 0], T_base_laser[0, 0])
    cos_z = float(np.clip(T_base_laser[2, 2], -1.0, 1.0))
    return Mounting(
        T_base_laser=(round(float(x), 6) + 0.0, round(float(y), 6) + 0.0, round(theta, 6) + 0.0),
        is_upside_down=cos_z < 0.0,
        tilt=math.acos(abs(cos_z)),
    )


def transform_matrix(
    translation: tuple[float, float, float], quaternion: tuple[float, float, float, float]
) -> FloatArray:
    """Rigid transform (4, 4) of a translation [m] and a quaternion (x, y, z, w) of any length but zero."""
    x, y, z, w = np.array(quaternion) / math.hypot(*quaternion)
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = translation
    return T
