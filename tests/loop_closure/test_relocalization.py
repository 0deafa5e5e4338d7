import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.relocalization import (
    PlaceHypothesis,
    RelocalizationConfig,
    find_consensus,
)

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
