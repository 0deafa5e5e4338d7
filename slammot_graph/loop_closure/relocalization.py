"""Where a lost robot's new local maps lie in the old map: hypotheses are collected until one stands out.

With nothing known of the motion between, one match proves little: rooms and corridors repeat. Each verified closure
proposes a transform that moves the new component onto the old map; those of several local maps must agree, and
clearly outnumber those for any other place.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import AtLeastOne, Checked, Count, Positive
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.submap import Place, Submap


@dataclass(frozen=True, kw_only=True)
class RelocalizationConfig(Checked):
    """What it takes to believe where a lost robot is.

    Attributes
    ----------
    same_place_m, same_place_rad : float
        Two hypotheses within these bounds are for the same place.
    min_agreeing, min_agreeing_alone : int
        Local maps of the new component that must agree; and where no hypothesis is for any other place.
    lead : float
        The winner has this many times the hypotheses of the next.
    n_recent : int
        Hypotheses of so many latest local maps count: a place that only looked alike gets no more after a while.
    """

    same_place_m: Positive = 0.6
    same_place_rad: Positive = 0.1
    min_agreeing: Count = 5
    min_agreeing_alone: Count = 4
    lead: AtLeastOne = 3.0
    n_recent: Count = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceHypothesis:
    """A local map of the new component seen at a place of the old map.

    Attributes
    ----------
    source : int
        Number of the local map.
    T_map_new : (3,) array
        Moves the new component, as it lies now, onto the old map.
    place : (3,) array
        Where the local map's anchor comes to lie.
    """

    source: int
    T_map_new: FloatArray
    place: FloatArray


class Relocalization:
    """Collects the hypotheses on where the latest component of the graph lies, until it is joined with the others.

    Attributes
    ----------
    joined : set of int
        Components whose place in the map is known.
    closures : list of Closure
        Between these and the latest component; each is a hypothesis.
    """

    def __init__(self, config: RelocalizationConfig) -> None:
        self.config = config
        self.joined = {0}
        self.closures: list[Closure] = []
        self._component = 0

    def is_apart(self, a: Submap | Place, b: Submap | Place) -> bool:
        """Tell whether nothing is known of the motion between two local maps."""
        if a.component == b.component:
            return False
        return not (a.component in self.joined and b.component in self.joined)

    def collect(self, new: Sequence[Closure], nodes: FloatArray) -> tuple[list[Closure], FloatArray] | None:
        """Add closures of a local map; None until enough of them agree.

        Parameters
        ----------
        new : sequence of Closure
            At least one, all of the same component.
        nodes : (n, 3) array
            Optimised poses of the graph.

        Returns
        -------
        The closures that agree, and the transform (3,) of the latest of them that moves the component onto the old map.
        """
        if new[0].source.component != self._component:
            self._component, self.closures = new[0].source.component, []
        self.closures += new
        hypotheses = [hypothesis_of(collected, nodes) for collected in self.closures]
        agreed = find_consensus(hypotheses, self.config)
        if not agreed:
            return None
        return [self.closures[k] for k in agreed], hypotheses[agreed[-1]].T_map_new

    def join(self) -> None:
        """Take the component's place for known."""
        self.joined.add(self._component)
        self.closures = []


def hypothesis_of(closure: Closure, nodes: FloatArray) -> PlaceHypothesis:
    """Give what a closure says of where its component lies; `nodes` (n, 3) are the poses of the graph."""
    place = se2.compose(nodes[closure.target.anchor], closure.T_target_source)
    T_map_new = se2.compose(place, se2.inverse(nodes[closure.source.anchor]))
    return PlaceHypothesis(source=closure.source.number, T_map_new=T_map_new, place=place)


def find_consensus(hypotheses: list[PlaceHypothesis], config: RelocalizationConfig) -> list[int]:
    """Give the indices of the hypotheses of the winning place; none while no place stands out."""
    if not hypotheses:
        return []
    sources = np.array([hypothesis.source for hypothesis in hypotheses])
    is_recent = sources > sources.max() - config.n_recent
    T = np.array([hypothesis.T_map_new for hypothesis in hypotheses])
    groups = [_is_same(hypothesis, T, config) & is_recent for hypothesis in hypotheses]
    n_agreeing = np.array([len(set(sources[group])) for group in groups])
    best = int(np.argmax(np.where(is_recent, n_agreeing, 0)))
    most_elsewhere = int(n_agreeing[is_recent & ~groups[best]].max(initial=0))
    needed: float = config.min_agreeing_alone
    if most_elsewhere:
        needed = max(config.min_agreeing, config.lead * most_elsewhere)
    if n_agreeing[best] < needed:
        return []
    return [int(k) for k in np.flatnonzero(groups[best])]


def _is_same(hypothesis: PlaceHypothesis, T_map_new: FloatArray, config: RelocalizationConfig) -> BoolArray:
    """Tell which transforms (k, 3) put the hypothesis's local map at the place that it is for."""
    anchor = se2.compose(se2.inverse(hypothesis.T_map_new), hypothesis.place)
    offset = se2.between(hypothesis.place[None, :], se2.compose(T_map_new, anchor[None, :]))
    is_near = np.hypot(offset[:, 0], offset[:, 1]) < config.same_place_m
    return np.asarray(is_near & (np.abs(offset[:, 2]) < config.same_place_rad))
