import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.relocalization import (
    LEAD,
    MIN_AGREEING,
    MIN_AGREEING_ALONE,
    N_RECENT,
    PlaceHypothesis,
    find_consensus,
)

TRUE = np.array([4.0, -3.0, 1.2])
ALIAS = np.array([9.0, -3.0, 1.2])


def votes_for(
    T_map_new: FloatArray, sources: range, seed: int = 0, std: float = 0.03
) -> list[PlaceHypothesis]:
    rng = np.random.default_rng(seed)
    votes = []
    for source in sources:
        anchor = np.array([2.0 * source, 0.5, 0.1])  # where the local map lies in the new component
        noise = se2.exp(rng.normal(0.0, [std, std, 0.2 * std]))
        place = se2.compose(se2.compose(T_map_new, anchor), noise)
        T = se2.compose(place, se2.inverse(anchor))
        votes.append(PlaceHypothesis(source=source, T_map_new=T, place=place))
    return votes


def test_enough_votes_that_agree_win() -> None:
    assert find_consensus([]) == []
    assert find_consensus(votes_for(TRUE, range(MIN_AGREEING_ALONE - 1))) == []
    assert find_consensus(votes_for(TRUE, range(MIN_AGREEING_ALONE))) == list(range(MIN_AGREEING_ALONE))


def test_one_vote_for_another_place_asks_for_one_more() -> None:
    rival = votes_for(ALIAS, range(1), seed=1)
    assert find_consensus(votes_for(TRUE, range(MIN_AGREEING - 1)) + rival) == []
    assert find_consensus(votes_for(TRUE, range(MIN_AGREEING)) + rival) == list(range(MIN_AGREEING))


def test_many_votes_of_one_local_map_are_one() -> None:
    assert find_consensus(votes_for(TRUE, range(1)) * (2 * MIN_AGREEING)) == []


def test_a_rival_place_holds_the_decision_up() -> None:
    rivals = votes_for(ALIAS, range(2), seed=1)
    few, many = votes_for(TRUE, range(MIN_AGREEING)), votes_for(TRUE, range(int(2 * LEAD)))
    assert find_consensus(few + rivals) == []
    assert find_consensus(many + rivals) == list(range(len(many)))


def test_a_place_that_only_looked_alike_is_forgotten_in_time() -> None:
    alias = votes_for(ALIAS, range(MIN_AGREEING - 1), seed=1)
    later = votes_for(TRUE, range(N_RECENT + MIN_AGREEING))
    winners = find_consensus(alias + later)
    assert len(winners) == N_RECENT
    assert min(winners) >= len(alias)


def test_turned_places_are_other_places() -> None:
    turned = se2.compose(TRUE, np.array([0.0, 0.0, 0.5]))
    assert find_consensus(votes_for(TRUE, range(3)) + votes_for(turned, range(3, 6))) == []


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_votes_does_not_matter(seed: int) -> None:
    votes = votes_for(TRUE, range(7)) + votes_for(ALIAS, range(2), seed=1)
    order = np.random.default_rng(seed).permutation(len(votes))
    shuffled = find_consensus([votes[k] for k in order])
    assert sorted(int(order[k]) for k in shuffled) == sorted(find_consensus(votes)) == list(range(7))
