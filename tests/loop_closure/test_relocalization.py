from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.place_evidence import Evidence
from slammot_graph.loop_closure.relocalization import (
    PlaceHypothesis,
    PossiblePlace,
    Relocalization,
    RelocalizationConfig,
    find_places,
)
from slammot_graph.loop_closure.submap import Place, Submap

CONFIG = RelocalizationConfig()

TRUE = np.array([4.0, -3.0, 1.2])
ALIAS = np.array([9.0, -3.0, 1.2])


def places(hypotheses: list[PlaceHypothesis]) -> list[list[int]]:
    return find_places(hypotheses, CONFIG)


def hypotheses_for(
    T_map_new: FloatArray, sources: range, seed: int = 0, std: float = 0.03
) -> list[PlaceHypothesis]:
    rng = np.random.default_rng(seed)
    hypotheses = []
    for source in sources:
        anchor = np.array([2.0 * source, 0.5, 0.1])  # where the local map lies in the new component
        noise = se2.exp(rng.normal(0.0, [std, std, 0.2 * std]))
        place = se2.compose(se2.compose(T_map_new, anchor), noise)
        T = se2.compose(place, se2.inverse(anchor))
        hypotheses.append(PlaceHypothesis(source=source, T_map_new=T, place=place))
    return hypotheses


def test_hypotheses_for_one_place_go_together_the_place_of_most_local_maps_first() -> None:
    assert places([]) == []
    assert places(hypotheses_for(ALIAS, range(2), seed=1) + hypotheses_for(TRUE, range(3))) == [
        [2, 3, 4],
        [0, 1],
    ]


def test_many_hypotheses_of_one_local_map_are_one() -> None:
    alone = hypotheses_for(ALIAS, range(1)) * 5
    assert places(alone + hypotheses_for(TRUE, range(2)))[0] == [5, 6]


def test_a_place_that_only_looked_alike_is_forgotten_in_time() -> None:
    alias = hypotheses_for(ALIAS, range(5), seed=1)
    (later,) = places(alias + hypotheses_for(TRUE, range(CONFIG.n_recent + 5)))
    assert len(later) == CONFIG.n_recent
    assert min(later) >= len(alias)


def test_turned_places_are_other_places() -> None:
    turned = se2.compose(TRUE, np.array([0.0, 0.0, 0.5]))
    assert len(places(hypotheses_for(TRUE, range(3)) + hypotheses_for(turned, range(3, 6)))) == 2


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_hypotheses_does_not_matter(seed: int) -> None:
    hypotheses = hypotheses_for(TRUE, range(7)) + hypotheses_for(ALIAS, range(2), seed=1)
    order = np.random.default_rng(seed).permutation(len(hypotheses))
    shuffled = places([hypotheses[k] for k in order])
    assert [sorted(int(order[k]) for k in rows) for rows in shuffled] == places(hypotheses)


def closure_for(T_map_new: FloatArray, source: int, component: int = 1) -> Closure:
    """A local map of the component, at node `source` of a straight graph, seen from node 0."""
    return Closure(
        target=Place(number=0, anchor=0, path_m=0.0, component=0),
        source=Place(number=source, anchor=source, path_m=0.0, component=component),
        T_target_source=se2.compose(T_map_new, NODES[source]),
        cov=np.eye(3),
        information=np.eye(3),
        overlap=1.0,
    )


NODES = np.array([[float(k), 0.0, 0.0] for k in range(30)])


def test_closures_are_collected_and_say_where_the_component_lies() -> None:
    relocalization = Relocalization(CONFIG)
    closures = [closure_for(TRUE, source) for source in range(10, 13)]
    for closure in closures[:-1]:
        relocalization.collect([closure], NODES)
    (place,) = relocalization.collect([closures[-1]], NODES)
    assert place.closures == closures
    assert place.n_agreeing == 3
    np.testing.assert_allclose(place.T_map_new, TRUE, atol=1e-9)


def test_a_robot_lost_again_begins_anew() -> None:
    relocalization = Relocalization(CONFIG)
    relocalization.collect([closure_for(TRUE, 10)], NODES)
    later = closure_for(TRUE, 20, component=2)
    relocalization.collect([later], NODES)
    assert relocalization.closures == [later]
    relocalization.join()
    assert relocalization.joined == {0, 2}
    assert relocalization.closures == []


class Weighed(Relocalization):
    """The places get the evidence that is given, in their order."""

    def __init__(self, *evidence: Evidence) -> None:
        super().__init__(CONFIG)
        self.evidence = list(evidence)

    def weigh(self, place: PossiblePlace, submaps: Sequence[Submap], nodes: FloatArray) -> Evidence:
        return self.evidence.pop(0)


def proposed(n_agreeing: int) -> PossiblePlace:
    return PossiblePlace(closures=[], n_agreeing=n_agreeing, T_map_new=TRUE)


def test_a_place_that_all_speaks_for_is_believed() -> None:
    place = proposed(3)
    assert Weighed(Evidence(200, 2)).decide([place], [], NODES) is place


def test_too_few_local_maps_are_not_weighed() -> None:
    assert Weighed().decide([proposed(2)], [], NODES) == "0 hypotheses so far"


def test_a_place_that_much_speaks_against_is_not_believed() -> None:
    reason = Weighed(Evidence(200, 25)).decide([proposed(9)], [], NODES)
    assert str(reason).startswith("what was seen tells too little, or fits no place well")


def test_of_two_places_that_fit_alike_none_is_believed() -> None:
    reason = Weighed(Evidence(200, 2), Evidence(195, 3)).decide([proposed(9), proposed(1)], [], NODES)
    assert str(reason).startswith("2 places fit alike")


def test_of_two_places_the_one_is_believed_that_fits_better() -> None:
    places = [proposed(4), proposed(3)]
    assert Weighed(Evidence(200, 30), Evidence(200, 2)).decide(places, [], NODES) is places[1]


def test_the_better_place_waits_until_enough_local_maps_agree() -> None:
    reason = Weighed(Evidence(200, 30), Evidence(200, 2)).decide([proposed(4), proposed(1)], [], NODES)
    assert isinstance(reason, str)


@pytest.mark.parametrize(
    ("a", "b", "is_apart"),
    [(0, 0, False), (1, 1, False), (0, 2, False), (0, 1, True), (1, 2, True), (2, 1, True)],
)
def test_components_are_apart_until_both_are_joined(a: int, b: int, is_apart: bool) -> None:
    relocalization = Relocalization(CONFIG)
    relocalization.joined |= {2}
    places = [Place(number=0, anchor=0, path_m=0.0, component=component) for component in (a, b)]
    assert relocalization.is_apart(*places) == is_apart


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"same_place_m": 0.0}, "RelocalizationConfig.same_place_m must be positive, not 0.0"),
        ({"p_contrary_same": 0.2}, "RelocalizationConfig needs p_contrary_same < p_contrary_other < 1"),
        ({"same_place_rad": -1.0}, "RelocalizationConfig.same_place_rad must be positive, not -1.0"),
        *[
            ({name: 0}, f"RelocalizationConfig.{name} must be at least 1, not 0")
            for name in ("min_agreeing", "n_recent", "n_weighed")
        ],
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        RelocalizationConfig(**changes)  # type: ignore[arg-type]
