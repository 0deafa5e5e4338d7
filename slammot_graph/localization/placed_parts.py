"""The poses of a run that looks for its place in a saved map: parts, of which each is placed once it is found."""

from array import array

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray

UPPER = np.triu_indices(3)
"""Of covariances their upper triangles are kept, in single precision."""


class PlacedParts:
    """Poses as told at the time, 48 bytes a scan; a part begins where the robot was lost."""

    def __init__(self) -> None:
        self._poses, self._covs = array("d"), array("f")
        self._parts: list[tuple[int, FloatArray | None]] = [(0, None)]

    def __len__(self) -> int:
        return len(self._poses) // 3

    @property
    def is_placed(self) -> bool:
        """Whether all parts are placed."""
        return all(T_map_local is not None for _, T_map_local in self._parts)

    def append(self, T_local_base: FloatArray, cov_map: FloatArray) -> None:
        """Add the next scan's pose (3,) in the local frame, and its covariance (3, 3) in the map (body frame)."""
        self._poses.extend(T_local_base.tolist())
        (xx, xy, xt), (_, yy, yt), (_, _, tt) = cov_map.tolist()
        self._covs.extend((xx, xy, xt, yy, yt, tt))

    def begin(self) -> None:
        """Begin a part with the next scan."""
        self._parts.append((len(self), None))

    def place(self, T_map_local: FloatArray, T_map_base: FloatArray, cov_map: FloatArray) -> None:
        """Place the latest part in the map.

        Parameters
        ----------
        T_map_local : (3,) array
            The local frame in the map.
        T_map_base : (n, 3) array
            Poses of the latest n scans as known now; those before the part are left out.
        cov_map : (n, 3, 3) array
            Their covariances, body frame.
        """
        first, _ = self._parts[-1]
        self._parts[-1] = first, T_map_local
        n = min(len(self) - first, len(T_map_base))  # where the scan at which it was lost lies nothing tells
        T_local_base = se2.compose(se2.inverse(T_map_local)[None, :], T_map_base[len(T_map_base) - n :])
        upper = cov_map[len(cov_map) - n :, UPPER[0], UPPER[1]]
        self._poses[3 * (len(self) - n) :] = array("d", T_local_base.ravel())
        self._covs[len(self._covs) - 6 * n :] = array("f", upper.ravel())

    def trajectory(self) -> tuple[FloatArray, FloatArray]:
        """Poses (n, 3) of all scans in the map, of parts that are not placed in their own frames; covariances."""
        poses = np.array(self._poses).reshape(-1, 3)
        covs = np.empty((len(poses), 3, 3))
        covs[:, UPPER[0], UPPER[1]] = np.array(self._covs, dtype=np.float64).reshape(-1, 6)
        covs[:, UPPER[1], UPPER[0]] = covs[:, UPPER[0], UPPER[1]]
        ends = [first for first, _ in self._parts[1:]] + [len(poses)]
        for (first, T_map_local), end in zip(self._parts, ends, strict=True):
            if T_map_local is not None:
                poses[first:end] = se2.compose(T_map_local[None, :], poses[first:end])
        return poses, covs
