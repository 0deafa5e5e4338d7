import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.relocalization import (
    PlaceHypothesis,
    Relocalization,
    RelocalizationConfig,
    find_consensus,
)
from slammot_graph.loop_closure.submap import Place

CONFIG = RelocalizationConfig()

TRUE = np.array([4.0, -3.0, 1.2])
ALIAS = np.array([9.0, -3.0, 1.2])


def consensus(hypotheses: list[PlaceHypothesis]) -> list[int]:
    return find_consensus(hypotheses, CONFIG)


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


def test_enough_hypotheses_that_agree_win() -> None:
    assert consensus([]) == []
    assert consensus(hypotheses_for(TRUE, range(CONFIG.min_agreeing_alone - 1))) == []
    assert consensus(hypotheses_for(TRUE, range(CONFIG.min_agreeing_alone))) == list(
        range(CONFIG.min_agreeing_alone)
    )


def test_one_hypothesis_for_another_place_asks_for_one_more() -> None:
    rival = hypotheses_for(ALIAS, range(1), seed=1)
    assert consensus(hypotheses_for(TRUE, range(CONFIG.min_agreeing - 1)) + rival) == []
    assert consensus(hypotheses_for(TRUE, range(CONFIG.min_agreeing)) + rival) == list(
        range(CONFIG.min_agreeing)
    )


def test_many_hypotheses_of_one_local_map_are_one() -> None:
    assert consensus(hypotheses_for(TRUE, range(1)) * (2 * CONFIG.min_agreeing)) == []


def test_a_rival_place_holds_the_decision_up() -> None:
    rivals = hypotheses_for(ALIAS, range(2), seed=1)
    few, many = (
        hypotheses_for(TRUE, range(CONFIG.min_agreeing)),
        hypotheses_for(TRUE, range(int(2 * CONFIG.lead))),
    )
    assert consensus(few + rivals) == []
    assert consensus(many + rivals) == list(range(len(many)))


def test_a_place_that_only_looked_alike_is_forgotten_in_time() -> None:
    alias = hypotheses_for(ALIAS, range(CONFIG.min_agreeing - 1), seed=1)
    later = hypotheses_for(TRUE, range(CONFIG.n_recent + CONFIG.min_agreeing))
    winners = consensus(alias + later)
    assert len(winners) == CONFIG.n_recent
    assert min(winners) >= len(alias)


def test_turned_places_are_other_places() -> None:
    turned = se2.compose(TRUE, np.array([0.0, 0.0, 0.5]))
    assert consensus(hypotheses_for(TRUE, range(3)) + hypotheses_for(turned, range(3, 6))) == []


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_hypotheses_does_not_matter(seed: int) -> None:
    hypotheses = hypotheses_for(TRUE, range(7)) + hypotheses_for(ALIAS, range(2), seed=1)
    order = np.random.default_rng(seed).permutation(len(hypotheses))
    shuffled = consensus([hypotheses[k] for k in order])
    assert sorted(int(order[k]) for k in shuffled) == sorted(consensus(hypotheses)) == list(range(7))


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


def test_closures_are_collected_until_they_agree_on_where_the_component_lies() -> None:
    relocalization = Relocalization(CONFIG)
    closures = [closure_for(TRUE, source) for source in range(10, 10 + CONFIG.min_agreeing_alone)]
    for closure in closures[:-1]:
        assert relocalization.collect([closure], NODES) is None
    found = relocalization.collect([closures[-1]], NODES)
    assert found is not None
    agreeing, T_map_new = found
    assert agreeing == closures
    np.testing.assert_allclose(T_map_new, TRUE, atol=1e-9)
    assert relocalization.joined == {0}
    relocalization.join()
    assert relocalization.joined == {0, 1}
    assert relocalization.closures == []


def test_a_robot_lost_again_begins_anew() -> None:
    relocalization = Relocalization(CONFIG)
    for source in range(10, 9 + CONFIG.min_agreeing_alone):
        relocalization.collect([closure_for(TRUE, source)], NODES)
    later = closure_for(TRUE, 20, component=2)
    assert relocalization.collect([later], NODES) is None
    assert relocalization.closures == [later]
    relocalization.join()
    assert relocalization.joined == {0, 2}


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
        ({"same_place_rad": -1.0}, "RelocalizationConfig.same_place_rad must be positive, not -1.0"),
        *[
            ({name: 0}, f"RelocalizationConfig.{name} must be at least 1, not 0")
            for name in ("min_agreeing", "min_agreeing_alone", "lead", "n_recent")
        ],
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        RelocalizationConfig(**changes)  # type: ignore[arg-type]
