"""The local map: the static points of the latest keyframes, ready for nearest-point queries in constant time."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive
from slammot_graph.core.linalg import eigh3
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping import _local_map_kernels


@dataclass(frozen=True, kw_only=True)
class LocalMapConfig(Checked):
    """When a keyframe is taken, how many make a local map, and how its points are thinned.

    Attributes
    ----------
    keyframe_distance_m, keyframe_rotation_rad : float
        Motion since the last keyframe that makes the next one.
    max_keyframes : int
        A local map with this many is full and is replaced by a new one ...
    n_overlap : int
        ... that starts with the latest `n_overlap` keyframes, anchored at the first of them.
    cell_m, reach_m : float
        Resolution of the nearest-point field, and how far from a point it reaches.
    spacing_m : float
        A point nearer than this to a like one is left out.
    field_m : float
        Side of the square after which the field repeats itself; more than twice the laser's range.
    normal_half_window_rad : float
        Beams up to this far on either side make a normal; at least 3.
    normal_max_gap_m : float
        Largest step between neighbouring points of a line, beside 3 times the beams' distance at that range.
    normal_max_thickness_m : float
        Largest root mean square thickness of a line.
    normal_std_rad : float
        A normal takes in more beams until its direction is known so well: three of a wall close by see a few
        centimetres of it, and normals that the beams' noise has turned tell of a way along it.
    """

    keyframe_distance_m: Positive = 0.3
    keyframe_rotation_rad: Positive = 0.2
    max_keyframes: Count = 15
    n_overlap: Count = 8
    cell_m: Positive = 0.05
    reach_m: Positive = 0.4
    spacing_m: Positive = 0.05
    field_m: Positive = 100.0
    normal_half_window_rad: Positive = 0.0525
    normal_max_gap_m: Positive = 0.4
    normal_max_thickness_m: Positive = 0.04
    normal_std_rad: Positive = 0.05

    def __post_init__(self) -> None:
        """See `Checked`."""
        super().__post_init__()
        self.require(self.n_overlap < self.max_keyframes, "needs n_overlap < max_keyframes")


NO_NODE = -1
"""In place of the node of a keyframe that is none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Keyframe:
    """A scan that became part of a local map.

    Attributes
    ----------
    node : int
        Its node in the pose graph, or `NO_NODE`.
    T_local_base : (3,) array
        Where the local matching placed it.
    points_base, normals_base : (m, 2) arrays
        Static points and their normals towards the laser, base frame; a normal of (0, 0) on no line.
    laser_base : (2,) array
        Where the laser was, base frame; of a sweep, in the mean.
    laser : int
        Which laser.
    """

    node: int
    T_local_base: FloatArray
    points_base: FloatArray
    normals_base: FloatArray
    laser_base: FloatArray
    laser: int = 0


def make_keyframe(
    node: int,
    T_local_base: FloatArray,
    points_base: FloatArray,
    is_static: BoolArray,
    laser: LaserModel,
    config: LocalMapConfig,
    origins_base: FloatArray | None = None,
) -> Keyframe:
    """Take the static points (n, 2) of a scan, in beam order, and find the lines they lie on.

    `origins_base`, (1, 2) or (n, 2) [m], are where the beams start from; by default where the laser sits.
    """
    laser_base = laser.origin_base
    if origins_base is not None and len(origins_base) > 1:
        laser_base = origins_base.mean(axis=0)
    normals = np.empty_like(points_base)
    step_rad = abs(laser.angle_increment)
    _local_map_kernels.estimate_normals(
        points_base,
        is_static,
        laser_base,
        max(3, round(config.normal_half_window_rad / step_rad)),
        config.normal_max_gap_m,
        3.0 * step_rad,
        config.normal_max_thickness_m,
        config.normal_std_rad,
        normals,
    )
    return Keyframe(
        node=node,
        T_local_base=T_local_base,
        points_base=points_base[is_static],
        normals_base=normals[is_static],
        laser_base=laser_base,
        laser=laser.number,
    )


class LocalMap:
    """Points with normals in the local frame, and for each cell around them the nearest one.

    The field wraps around and is never cleared: a cell holds the running number of a point, and numbers below
    `first` belong to earlier local maps.

    Attributes
    ----------
    keyframes : list of Keyframe
        The first one is the anchor.
    points, normals : (capacity, 2) arrays
        Ring buffers by running number.
    nearest : (side, side) int32 array
    owner : (capacity,) int32 array
        Which of the keyframes a point comes from.
    T_local_keyframes : (k, 3) array
    keyframe_roots : (k, 3, 3) array
        Square roots of the keyframes' covariances relative to the anchor (body frames).
    first, end : int
        Running numbers of the current points.
    """

    CAPACITY = 1 << 16

    def __init__(self, config: LocalMapConfig) -> None:
        self.config = config
        self.keyframes: list[Keyframe] = []
        self.inv_cell = 1.0 / config.cell_m
        side = 1 << math.ceil(math.log2(config.field_m / config.cell_m))
        self.points = np.zeros((self.CAPACITY, 2))
        self.normals = np.zeros((self.CAPACITY, 2))
        self.nearest = np.full((side, side), -1, dtype=np.int32)
        self.owner = np.zeros(self.CAPACITY, dtype=np.int32)
        self.T_local_keyframes = np.empty((0, 3))
        self.keyframe_roots = np.empty((0, 3, 3))
        self.first = self.end = 0
        self._n_lasers = 1

    @property
    def max_keyframes(self) -> int:
        """Keyframes of a full local map: those of each laser cover the same distance, however many lasers there are."""
        return self._n_lasers * self.config.max_keyframes

    @property
    def n_overlap(self) -> int:
        """Keyframes with which the next one starts."""
        return self._n_lasers * self.config.n_overlap

    @property
    def anchor(self) -> Keyframe:
        """The keyframe that the local map is attached to."""
        return self.keyframes[0]

    def wants(self, T_local_base: FloatArray, laser: int = 0) -> bool:
        """Tell whether the robot has moved enough since the last keyframe of this laser, or there is none."""
        if not self.keyframes:
            return True
        last = self.keyframes[-1]
        if last.laser != laser:
            of_laser = [keyframe for keyframe in self.keyframes if keyframe.laser == laser]
            if not of_laser:
                return True
            last = of_laser[-1]
        distance_m, turn_rad = se2.distance(last.T_local_base, T_local_base)
        return distance_m > self.config.keyframe_distance_m or turn_rad > self.config.keyframe_rotation_rad

    def add(self, keyframe: Keyframe, cov_anchor: FloatArray | None = None) -> tuple[Keyframe, ...]:
        """Take in a keyframe; the keyframes of the map that this filled, when a new one took over, else none.

        `cov_anchor` (3, 3) is the keyframe's covariance relative to the anchor (body frame); by default zero. Of a map
        that takes over, give those of its keyframes to `set_covariances`.
        """
        self.keyframes.append(keyframe)
        self._insert(keyframe, cov_anchor)
        if len(self.keyframes) < self.max_keyframes:
            return ()
        finished = tuple(self.keyframes)
        self.start(self.keyframes[-self.n_overlap :])
        self._n_lasers = max(self._n_lasers, len({keyframe.laser for keyframe in finished}))
        return finished

    def start(self, keyframes: list[Keyframe]) -> None:
        """Begin a new local map from the given keyframes; with none it is empty."""
        self.keyframes = list(keyframes)
        self.first = self.end
        self.T_local_keyframes, self.keyframe_roots = np.empty((0, 3)), np.empty((0, 3, 3))
        for keyframe in self.keyframes:
            self._insert(keyframe)

    def extend(self, keyframes: list[Keyframe]) -> None:
        """Take in keyframes that lie as surely as the anchor; however many there are, no new map takes over."""
        self.keyframes += keyframes
        for keyframe in keyframes:
            self._insert(keyframe)

    def set_covariances(self, covs_anchor: FloatArray) -> None:
        """Set the (k, 3, 3) covariances of the k keyframes relative to the anchor (body frames)."""
        self.keyframe_roots = np.array([_root(cov) for cov in covs_anchor])

    def current_points(self) -> FloatArray:
        """(n, 2) points of the local map in the local frame [m]."""
        return self.points[np.arange(self.first, self.end) % self.CAPACITY]

    @property
    def owned_points(
        self,
    ) -> tuple[FloatArray, npt.NDArray[np.int32], float, int, npt.NDArray[np.int32], FloatArray]:
        """The points, where they lie, and which keyframe saw each from where, as the kernels take them."""
        return self.points, self.nearest, self.inv_cell, self.first, self.owner, self.T_local_keyframes

    def _insert(self, keyframe: Keyframe, cov_anchor: FloatArray | None = None) -> None:
        T, begin = keyframe.T_local_base, self.end
        root = np.zeros((3, 3)) if cov_anchor is None else _root(cov_anchor)
        self.T_local_keyframes = np.vstack([self.T_local_keyframes, T])
        self.keyframe_roots = np.concatenate([self.keyframe_roots, root[None]])
        self.end = _local_map_kernels.insert_points(
            self.points,
            self.normals,
            self.nearest,
            self.inv_cell,
            self.first,
            self.end,
            se2.transform(T, keyframe.points_base),
            keyframe.normals_base @ se2.rotation(T[2]).T,
            np.ones(len(keyframe.points_base), dtype=np.bool_),
            self.config.spacing_m,
            math.ceil(self.config.reach_m * self.inv_cell),
        )
        self.owner[np.arange(begin, self.end) % self.CAPACITY] = len(self.T_local_keyframes) - 1


def _root(cov: FloatArray) -> FloatArray:
    """A (3, 3) matrix whose square is the covariance, which may be zero."""
    values, vectors = np.empty(3), np.empty((3, 3))
    eigh3(cov, values, vectors)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return root
