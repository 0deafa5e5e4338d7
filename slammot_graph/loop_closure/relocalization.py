"""Where a lost robot's new local maps lie in the old map: hypotheses are collected until one stands out.

With nothing known of the motion between, one match proves little: rooms and corridors repeat. Each verified closure
proposes a transform that moves the new component onto the old map; those of several local maps must agree. Then the
whole component is laid there: what agrees and what the one has seen through of the other must speak for that place
against one that looks alike, and against any other place that is proposed. Until then the robot waits and drives on.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive, PositiveShare
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.place_evidence import Evidence, placed_keyframes, weigh_place
from slammot_graph.loop_closure.submap import Place, Submap


@dataclass(frozen=True, kw_only=True)
class RelocalizationConfig(Checked):
    """What it takes to believe where a lost robot is.

    Attributes
    ----------
    same_place_m, same_place_rad : float
        Two hypotheses within these bounds are for the same place.
    min_agreeing : int
        Local maps of the new component that must agree.
    n_recent : int
        Hypotheses of so many latest local maps count: a place that only looked alike gets no more after a while.
    p_contrary_same, p_contrary_other : float
        Share of the squares of wall that the other map contradicts, in the same place and in one that looks alike; less
        where another place of the map is contradicted less.
    min_log_ratio, min_lead : float
        Logarithm of the ratio of likelihoods: of the place against one that looks alike, and against the next best.
    n_weighed : int
        So many places are weighed, those of most local maps.
    """

    same_place_m: Positive = 0.6
    same_place_rad: Positive = 0.1
    min_agreeing: Count = 3
    n_recent: Count = 12
    p_contrary_same: PositiveShare = 0.04
    p_contrary_other: PositiveShare = 0.12
    min_log_ratio: Positive = 3.0
    min_lead: Positive = 6.0
    n_weighed: Count = 4

    def __post_init__(self) -> None:
        """See `Checked`."""
        super().__post_init__()
        self.require(
            self.p_contrary_same < self.p_contrary_other < 1.0, "needs p_contrary_same < p_contrary_other < 1"
        )


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


@dataclass(frozen=True, kw_only=True, eq=False)
class PossiblePlace:
    """Where several local maps of the new component say that it lies.

    Attributes
    ----------
    closures : list of Closure
    n_agreeing : int
        Different local maps among them.
    T_map_new : (3,) array
        By the latest of them; moves the new component, as it lies now, onto the old map.
    T_repeat : (3,) array
        Identity; of a place that only looks like the one that the closures are for, what moves that one there.
    """

    closures: list[Closure]
    n_agreeing: int
    T_map_new: FloatArray
    T_repeat: FloatArray = field(default_factory=lambda: se2.IDENTITY)

    @property
    def target(self) -> int:
        """Number of the local map of the old map that most of the closures are with."""
        return Counter(closure.target.number for closure in self.closures).most_common(1)[0][0]

    def repeated(self, moves: FloatArray) -> "list[PossiblePlace]":
        """Give the places that transforms (k, 3) move this one to, for which no local map speaks."""
        return [replace(self, n_agreeing=0, T_repeat=T) for T in moves]


class Relocalization:
    """Collects the hypotheses on where the latest component of the graph lies, until it is joined with the others.

    Attributes
    ----------
    joined : set of int
        Components whose place in the map is known.
    closures : list of Closure
        Between these and the latest component; each is a hypothesis.
    unfinished : Submap or None
        The latest local map that was looked for, which may be part of no finished one yet.
    """

    def __init__(self, config: RelocalizationConfig) -> None:
        self.config = config
        self.joined = {0}
        self.closures: list[Closure] = []
        self.unfinished: Submap | None = None
        self._component = 0

    def is_apart(self, a: Submap | Place, b: Submap | Place) -> bool:
        """Tell whether nothing is known of the motion between two local maps."""
        if a.component == b.component:
            return False
        return not (a.component in self.joined and b.component in self.joined)

    def collect(self, new: Sequence[Closure], nodes: FloatArray) -> list[PossiblePlace]:
        """Add closures of a local map; gives the places that are proposed, that of most local maps first.

        Parameters
        ----------
        new : sequence of Closure
            All of the same component.
        nodes : (n, 3) array
            Optimised poses of the graph.
        """
        if new and new[0].source.component != self._component:
            self._component, self.closures = new[0].source.component, []
        self.closures += new
        hypotheses = [hypothesis_of(collected, nodes) for collected in self.closures]
        return [
            PossiblePlace(
                closures=[self.closures[k] for k in rows],
                n_agreeing=len({hypotheses[k].source for k in rows}),
                T_map_new=hypotheses[rows[-1]].T_map_new,
            )
            for rows in find_places(hypotheses, self.config)
        ]

    def decide(
        self, places: Sequence[PossiblePlace], submaps: Sequence[Submap], nodes: FloatArray
    ) -> PossiblePlace | str:
        """Give the place that the whole component speaks for, or why there is none yet.

        Parameters
        ----------
        places : sequence of PossiblePlace
            As of `collect`, and others that look alike.
        submaps : sequence of Submap
            All of them.
        nodes : (n, 3) array
            Optimised poses of the graph.
        """
        config = self.config
        if places[0].n_agreeing < config.min_agreeing:
            return f"{len(self.closures)} hypotheses so far"
        evidence = [self.weigh(place, submaps, nodes) for place in places]
        ratios = [one.log_ratio(config.p_contrary_same, config.p_contrary_other) for one in evidence]
        best, *others = sorted(range(len(ratios)), key=lambda k: -ratios[k])
        # how much places contradict that look alike in this map
        p_other = min(
            [config.p_contrary_other, *(evidence[k].share(config.p_contrary_other) for k in others)]
        )
        lead = ratios[best] - max([ratios[k] for k in others], default=-math.inf)
        if p_other <= config.p_contrary_same or lead < config.min_lead:
            return f"{len(places)} places fit alike, log likelihood ratio {lead:.1f}"
        ratio = evidence[best].log_ratio(config.p_contrary_same, p_other)
        if places[best].n_agreeing < config.min_agreeing or ratio < config.min_log_ratio:
            return f"what was seen tells too little, or fits no place well, log likelihood ratio {ratio:.1f}"
        return places[best]

    def weigh(self, place: PossiblePlace, submaps: Sequence[Submap], nodes: FloatArray) -> Evidence:
        """Give what speaks for a place and against it; see `decide`.

        Each local map of the component lies where the closure next to it says, as all of them together may be bent.
        """
        own = [submap for submap in submaps if submap.component == self._component]
        if self.unfinished is not None and self.unfinished.component == self._component:
            own.append(self.unfinished)
        old = [submap for submap in submaps if submap.component in self.joined]
        anchors = nodes[[submap.anchor for submap in own]]
        from_anchors = np.array([closure.source.anchor for closure in place.closures])
        T_map_new = se2.compose(
            place.T_repeat[None, :],
            np.array([hypothesis_of(closure, nodes).T_map_new for closure in place.closures]),
        )
        nearest = [int(np.argmin(np.abs(from_anchors - submap.anchor))) for submap in own]
        return weigh_place(
            placed_keyframes(old, nodes[[submap.anchor for submap in old]]),
            placed_keyframes(own, se2.compose(T_map_new[nearest], anchors)),
        )

    def join(self) -> None:
        """Take the component's place for known."""
        self.joined.add(self._component)
        self.closures, self.unfinished = [], None


def hypothesis_of(closure: Closure, nodes: FloatArray) -> PlaceHypothesis:
    """Give what a closure says of where its component lies; `nodes` (n, 3) are the poses of the graph."""
    place = se2.compose(nodes[closure.target.anchor], closure.T_target_source)
    T_map_new = se2.compose(place, se2.inverse(nodes[closure.source.anchor]))
    return PlaceHypothesis(source=closure.source.number, T_map_new=T_map_new, place=place)


def find_places(hypotheses: list[PlaceHypothesis], config: RelocalizationConfig) -> list[list[int]]:
    """Give the indices of the recent hypotheses that are for one place, for each; that of most local maps first."""
    if not hypotheses:
        return []
    sources = np.array([hypothesis.source for hypothesis in hypotheses])
    is_left = sources > sources.max() - config.n_recent
    T = np.array([hypothesis.T_map_new for hypothesis in hypotheses])
    same = np.array([_is_same(hypothesis, T, config) for hypothesis in hypotheses])
    places: list[list[int]] = []
    while is_left.any():
        n_agreeing = [
            len(set(sources[row & is_left])) if left else 0 for row, left in zip(same, is_left, strict=True)
        ]
        rows = same[int(np.argmax(n_agreeing))] & is_left
        places.append(np.flatnonzero(rows).tolist())
        is_left &= ~rows
    return places


def _is_same(hypothesis: PlaceHypothesis, T_map_new: FloatArray, config: RelocalizationConfig) -> BoolArray:
    """Tell which transforms (k, 3) put the hypothesis's local map at the place that it is for."""
    anchor = se2.compose(se2.inverse(hypothesis.T_map_new), hypothesis.place)
    offset = se2.between(hypothesis.place[None, :], se2.compose(T_map_new, anchor[None, :]))
    is_near = np.hypot(offset[:, 0], offset[:, 1]) < config.same_place_m
    return np.asarray(is_near & (np.abs(offset[:, 2]) < config.same_place_rad))
