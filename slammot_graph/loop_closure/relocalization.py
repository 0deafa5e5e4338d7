"""Where a lost robot's new local maps lie in the old map: hypotheses are collected until one stands out.

With nothing known of the way between, one match proves little: rooms and corridors repeat. Each verified closure
proposes a transform that carries the new component onto the old map; those of several local maps must agree, and
clearly outnumber those for any other place.
"""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray

SAME_PLACE_M, SAME_PLACE_RAD = 0.6, 0.1
"""Two hypotheses within these bounds are for the same place."""

MIN_AGREEING, MIN_AGREEING_ALONE = 5, 4
"""Local maps of the new component that must agree; and where no hypothesis is for any other place."""

LEAD = 3.0
"""The winner has this many times the hypotheses of the next."""

N_RECENT = 12
"""Votes of the latest local maps count: a place that only looked alike gets no more hypotheses after a while."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceHypothesis:
    """A local map of the new component seen at a place of the old map.

    Attributes
    ----------
    source : int
        Number of the local map.
    T_map_new : (3,) array
        Carries the new component, as it lies now, onto the old map.
    place : (3,) array
        Where the local map's anchor comes to lie.
    """

    source: int
    T_map_new: FloatArray
    place: FloatArray


def find_consensus(hypotheses: list[PlaceHypothesis]) -> list[int]:
    """Give the indices of the hypotheses of the winning place; none while no place stands out."""
    if not hypotheses:
        return []
    sources = np.array([hypothesis.source for hypothesis in hypotheses])
    is_recent = sources > sources.max() - N_RECENT
    T = np.array([hypothesis.T_map_new for hypothesis in hypotheses])
    groups = [_is_same(hypothesis, T) & is_recent for hypothesis in hypotheses]
    n_votes = np.array([len(set(sources[group])) for group in groups])
    best = int(np.argmax(np.where(is_recent, n_votes, 0)))
    most_elsewhere = int(n_votes[is_recent & ~groups[best]].max(initial=0))
    needed = max(MIN_AGREEING, LEAD * most_elsewhere) if most_elsewhere else MIN_AGREEING_ALONE
    if n_votes[best] < needed:
        return []
    return [int(k) for k in np.flatnonzero(groups[best])]


def _is_same(hypothesis: PlaceHypothesis, T_map_new: FloatArray) -> BoolArray:
    """Tell which transforms (k, 3) put the hypothesis's local map at the place that it hypotheses for."""
    anchor = se2.compose(se2.inverse(hypothesis.T_map_new), hypothesis.place)
    offset = se2.between(hypothesis.place[None, :], se2.compose(T_map_new, anchor[None, :]))
    is_near = np.hypot(offset[:, 0], offset[:, 1]) < SAME_PLACE_M
    return np.asarray(is_near & (np.abs(offset[:, 2]) < SAME_PLACE_RAD))
