"""The pose graph's factors around the local map, and the marginal covariances of its keyframes from them alone."""

from typing import NamedTuple

import numpy as np

from slammot_graph.core.errors import SlammotError
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import _kernels

MAP = -1
"""Number of the local map itself among the keyframes."""

_BARELY = 1e-4 * np.eye(3)
"""Information that ties each node to the local map, so that the system can be solved [1/m^2, 1/rad^2]."""

_FIRMLY = 1e8 * np.eye(3)


class _Factor(NamedTuple):
    """The pose of a keyframe in the frame of another one, or of the local map."""

    from_keyframe: int
    to_keyframe: int
    T_from_to: FloatArray
    information: FloatArray


class LocalFactors:
    """Odometry from keyframe to keyframe, and each keyframe's match on the local map.

    In the whole graph a match is attached to the anchor. But it was made on the points of all keyframes of the local
    map, and these go over into the next one: here the local map is a node of its own that all matches refer to. The
    errors relative to an anchor thus do not grow from one local map to the next as long as matches hold it in place,
    and where they do not, as along a corridor, they grow with the odometry.
    """

    def __init__(self) -> None:
        self._n_keyframes = 0
        self._edges: list[_Factor] = []

    def start(self, T_local_base: FloatArray) -> None:
        """Begin with a first keyframe, which defines where the local map lies."""
        self._n_keyframes = 1
        self._edges = [_Factor(MAP, 0, T_local_base, _FIRMLY)]

    def add(
        self,
        T_last_this: FloatArray,
        odometry_information: FloatArray,
        T_local_base: FloatArray,
        match_information: FloatArray,
    ) -> None:
        """Add a keyframe: its motion from the last one, its pose in the local map and what its match tells of that.

        The match's information (3, 3) is zero where there was none.
        """
        this = self._n_keyframes
        self._n_keyframes += 1
        self._edges += [
            _Factor(this - 1, this, T_last_this, odometry_information),
            _Factor(MAP, this, T_local_base, match_information + _BARELY),
        ]

    def of_latest(self, n: int) -> FloatArray:
        """Move on to a new anchor, the first of the latest n keyframes, and forget what lies before it.

        Returns
        -------
        (n, 3, 3) array
            Marginal covariances of these keyframes relative to the anchor, right perturbation (body frames): of the
            linearised graph of their factors, with the anchor held.

        Raises
        ------
        SlammotError
            The information of a factor is not positive semi-definite.
        """
        anchor = self._n_keyframes - n
        self._edges = [
            e
            for e in self._edges
            if e.to_keyframe >= anchor and (e.from_keyframe == MAP or e.from_keyframe >= anchor)
        ]
        # the anchor is held, the local map comes last
        from_nodes = [n - 1 if e.from_keyframe == MAP else e.from_keyframe - anchor - 1 for e in self._edges]
        covs = np.zeros((n + 1, 3, 3))
        if not _kernels.block_covariances(
            np.array(from_nodes),
            np.array([e.to_keyframe - anchor - 1 for e in self._edges]),
            np.array([e.T_from_to for e in self._edges]),
            np.array([e.information for e in self._edges]),
            covs[1:],
        ):
            raise SlammotError("the covariances of the local map's keyframes cannot be solved for")
        return covs[:-1]
