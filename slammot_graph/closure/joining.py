"""Where a lost robot's new local maps lie in the old map: hypotheses are collected until one stands out.

With nothing known of the way between, one match proves little: rooms and corridors repeat. Each verified closure
votes for the transform that carries the new piece onto the old map; votes of several local maps must agree, and
clearly outnumber those for any other place.
"""

from dataclasses import dataclass

import numpy as np

from slammot_graph import se2
from slammot_graph.types import BoolArray, FloatArray

SAME_PLACE_M, SAME_PLACE_RAD = 0.6, 0.1
"""Two votes within these bounds are for the same place."""

MIN_VOTES, MIN_VOTES_ALONE = 5, 4
"""Local maps of the new piece that must agree; and where no vote is for any other place."""

LEAD = 3.0
"""The winner has this many times the votes of the next."""

N_RECENT = 12
"""Votes of the latest local maps count: a place that only looked alike gets no more votes after a while."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Vote:
    """A local map of the new piece seen at a place of the old map.

    Attributes
    ----------
    source : int
        Number of the local map.
    T_map_new : (3,) array
        Carries the new piece, as it lies now, onto the old map.
    place : (3,) array
        Where the local map's anchor comes to lie.
    """

    source: int
    T_map_new: FloatArray
    place: FloatArray


def elect(votes: list[Vote]) -> list[int]:
    """Give the indices of the votes of the winning place; none while no place stands out."""
    if not votes:
        return []
    sources = np.array([vote.source for vote in votes])
    is_recent = sources > sources.max() - N_RECENT
    T = np.array([vote.T_map_new for vote in votes])
    groups = [_is_same(vote, T) & is_recent for vote in votes]
    n_votes = np.array([len(set(sources[group])) for group in groups])
    best = int(np.argmax(np.where(is_recent, n_votes, 0)))
    most_elsewhere = int(n_votes[is_recent & ~groups[best]].max(initial=0))
    needed = max(MIN_VOTES, LEAD * most_elsewhere) if most_elsewhere else MIN_VOTES_ALONE
    if n_votes[best] < needed:
        return []
    return [int(k) for k in np.flatnonzero(groups[best])]


def _is_same(vote: Vote, T_map_new: FloatArray) -> BoolArray:
    """Tell which transforms (k, 3) put the vote's local map at the place that it votes for."""
    anchor = se2.compose(se2.inverse(vote.T_map_new), vote.place)
    offset = se2.between(vote.place[None, :], se2.compose(T_map_new, anchor[None, :]))
    is_near = np.hypot(offset[:, 0], offset[:, 1]) < SAME_PLACE_M
    return np.asarray(is_near & (np.abs(offset[:, 2]) < SAME_PLACE_RAD))
