"""Factors of a match onto the local map: to the anchor, or also to the keyframe whose points it rests on.

A match tells of the base relative to the points that it was made on. Where the local map is well known in itself that
is as good as relative to its anchor. Down a corridor it is not: a door that the latest keyframes saw ties the base to
these, and how far they are from the anchor the odometry alone tells. Called a measure of the way from the anchor, one
such match after the other would let the graph be sure of a drifted way.
"""

from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.local_map import Keyframe

MAX_RATIO = 1.0
"""The match is the anchor's alone where its own variance is larger than that of the map under it, in all directions."""


class MatchFactor(NamedTuple):
    """Node that a match refers to, pose (3,) relative to it, and information (3, 3) (body frame)."""

    node: int
    T_node_base: FloatArray
    information: FloatArray


def match_factors(match: MatchResult, keyframes: list[Keyframe]) -> list[MatchFactor]:
    """Divide a match's information among the nodes of the local map's keyframes, of which the first is the anchor.

    With G the match's information and C the covariance that the local map's keyframes bring, the anchor gets
    ``inv(inv(G) + C)``, and what G has beyond that the keyframe whose points tell most of it.
    """
    anchor, information = keyframes[0], match.graph_information
    whole = MatchFactor(anchor.node, match.T_ref_base, information)
    if match.map_scatter is None or not _is_map_worse(information, match.cov_map):
        return [whole]
    of_anchor = np.linalg.solve(np.eye(3) + information @ match.cov_map, information)
    of_anchor = 0.5 * (of_anchor + of_anchor.T)
    values, vectors = np.linalg.eigh(information - of_anchor)
    rest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    told = np.einsum("i,kij,j->k", vectors[:, -1], match.map_scatter, vectors[:, -1])
    told[[keyframe.node < 0 for keyframe in keyframes]] = 0.0
    most = keyframes[int(np.argmax(told))]
    if most is anchor:
        return [whole]
    T_local_base = se2.compose(anchor.T_local_base, match.T_ref_base)
    return [
        MatchFactor(anchor.node, match.T_ref_base, of_anchor),
        MatchFactor(most.node, se2.between(most.T_local_base, T_local_base), rest),
    ]


def _is_map_worse(information: FloatArray, cov_map: FloatArray) -> bool:
    """Tell whether in some direction the map's variance is more than the match's own."""
    return bool(np.linalg.eigvals(information @ cov_map).real.max() > MAX_RATIO)
