"""Which closures the graph is told, and when."""

from collections.abc import Iterator

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from slammot_graph.loop_closure import Closure, LoopCloser, LoopClosureConfig, Submap
from slammot_graph.mapping.local_map import Keyframe, LocalMapConfig
from tests.rooms import errors

STEP_COV: FloatArray = np.diag([0.1, 0.1, 0.02]) ** 2
COV = np.diag([0.2, 0.2, 0.05]) ** 2
CLOSURE_COV = np.diag([0.01, 0.01, 0.005]) ** 2
N_NODES = 60


def there_and_back(step_cov: FloatArray) -> LoopCloser:
    """A graph that went 30 m and came back."""
    graph = PoseGraph(PoseGraphConfig())
    graph.start(np.zeros(3))
    for k in range(1, N_NODES):
        step = np.array([1.0, 0.0, np.pi if k == N_NODES // 2 else 0.0])
        graph.add_node(se2.compose(graph.pose(k - 1), step))
        graph.add_edge("odometry", k - 1, k, step, np.linalg.inv(step_cov).astype(np.float64))
        graph.update()
    return LoopCloser(LoopClosureConfig(), LocalMapConfig(), graph)


@pytest.fixture
def closer() -> Iterator[LoopCloser]:
    """On odometry alone."""
    closer = there_and_back(STEP_COV)
    yield closer
    closer.graph.close()


@pytest.fixture
def stiff_closer() -> Iterator[LoopCloser]:
    """On matches."""
    closer = there_and_back(np.diag([0.01, 0.01, 0.003]) ** 2)
    yield closer
    closer.graph.close()


def submap(node: int) -> Submap:
    """A local map at every second node, numbered along the path."""
    nothing = np.empty((0, 2))
    keyframe = Keyframe(
        node=node, T_local_base=np.zeros(3), points_base=nothing, normals_base=nothing, laser_base=np.zeros(2)
    )
    return Submap(node // 2, (keyframe,), float(node))


def decide(
    closer: LoopCloser,
    target: int,
    source: int,
    moved: tuple[float, float, float] | FloatArray,
    cov: FloatArray = COV,
) -> tuple[bool, str]:
    """A closure that says: what came later lies elsewhere in the map, by `moved`."""
    nodes = closer.graph.poses()
    measured = se2.between(nodes[target], se2.compose(np.array(moved), nodes[source]))
    closure = Closure(
        target=submap(target).place,
        source=submap(source).place,
        T_target_source=measured,
        cov=CLOSURE_COV,
        information=np.linalg.inv(CLOSURE_COV),
        overlap=1.0,
    )
    attempt = closer.decide(closure, se2.between(nodes[target], nodes[source]), cov)
    assert (attempt.target_node, attempt.source_node) == (target, source)
    return attempt.status == "accepted", attempt.text.removeprefix(f"closure {target}-{source} ")


def closures(closer: LoopCloser) -> list[tuple[int, int]]:
    return [(e.from_node, e.to_node) for e in closer.graph.edges if e.kind == "closure"]


def test_a_probable_closure_is_accepted_at_once(closer: LoopCloser) -> None:
    before = closer.graph.poses()
    assert decide(closer, 10, 50, (0.0, 0.6, 0.0)) == (True, "accepted")
    assert closures(closer) == [(10, 50)]
    ((closure, edge),) = closer.accepted
    assert (closure.target.anchor, closure.source.anchor) == (edge.from_node, edge.to_node) == (10, 50)
    assert closer.pending == []
    after = closer.graph.poses()
    np.testing.assert_allclose(after[50] - before[50], [0.0, 0.6, 0.0], atol=0.02)
    assert np.abs(after[:11] - before[:11]).max() < 0.02


@pytest.mark.parametrize("moved", [(0.0, 3.3, 0.0), (-3.3, 0.0, 0.0), (0.0, 0.0, 1.5), (40.0, 5.0, 3.0)])
def test_an_improbable_closure_is_refused(closer: LoopCloser, moved: tuple[float, float, float]) -> None:
    accepted, reason = decide(closer, 0, 58, moved)
    assert not accepted
    assert reason.startswith("refused: improbable, squared Mahalanobis distance ")
    assert int(reason.split()[-1]) > 260
    assert (closures(closer), closer.pending, closer.accepted) == ([], [], [])


def test_the_limits_are_those_of_the_configuration(closer: LoopCloser) -> None:
    config, std = closer.config, np.sqrt(COV[1, 1] + CLOSURE_COV[1, 1])
    most = np.sqrt(config.gate)
    assert decide(closer, 0, 58, (0.0, 0.99 * most * config.gate_scale * std, 0.0))[1].startswith("waits")
    assert decide(closer, 0, 58, (0.0, 1.01 * most * config.gate_scale * std, 0.0))[1].startswith("refused")
    assert decide(closer, 0, 58, (0.0, 1.01 * most * std, 0.0))[1].startswith("waits")
    assert decide(closer, 0, 58, (0.0, 0.99 * most * std, 0.0)) == (True, "accepted")


def test_an_unlikely_closure_waits_for_a_consistent_second_one(closer: LoopCloser) -> None:
    before, moved = closer.graph.poses(), np.array([0.1, 1.5, 0.02])
    accepted, reason = decide(closer, 10, 50, moved)
    assert not accepted
    assert reason.startswith("waits for another to confirm it, squared Mahalanobis distance ")
    assert [(c.target.anchor, c.source.anchor) for c in closer.pending] == [(10, 50)]
    np.testing.assert_array_equal(closer.graph.poses(), before)
    assert decide(closer, 6, 54, moved) == (True, "accepted, confirmed by 1 others")
    assert closures(closer) == [(10, 50), (6, 54)]
    assert (closer.pending, len(closer.accepted)) == ([], 2)
    expected = se2.compose(moved, before[[50, 54]])
    np.testing.assert_allclose(closer.graph.poses()[[50, 54]], expected, atol=0.03)


def test_two_false_closures_that_disagree_stay_pending(closer: LoopCloser) -> None:
    before = closer.graph.poses()
    for source, moved in ((50, (0.0, 1.5, 0.0)), (54, (0.0, -1.5, 0.0)), (46, (1.6, 0.0, 0.0))):
        accepted, reason = decide(closer, 60 - source, source, moved)
        assert not accepted
        assert reason.startswith("waits")
    assert len(closer.pending) == 3
    assert (closures(closer), closer.accepted) == ([], [])
    np.testing.assert_array_equal(closer.graph.poses(), before)


def test_the_true_one_of_three_is_told_from_the_false(closer: LoopCloser) -> None:
    decide(closer, 10, 50, (0.0, 1.5, 0.0))
    decide(closer, 14, 46, (0.0, -1.5, 0.0))
    assert decide(closer, 6, 54, (0.0, 1.5, 0.0))[0]
    assert closures(closer) == [(10, 50), (6, 54)]
    assert [c.source.anchor for c in closer.pending] == [46]


def test_neighbours_and_places_far_apart_confirm_nothing(closer: LoopCloser) -> None:
    moved = (0.0, 1.5, 0.0)
    decide(closer, 4, 56, moved)
    # overlapping local maps share their keyframes: one error makes both
    assert decide(closer, 6, 56, moved)[1].startswith("waits")
    assert decide(closer, 2, 58, moved)[1].startswith("waits")
    closer.pending = closer.pending[:1]
    # the path between, 44 m, is as uncertain as what is to be confirmed
    assert decide(closer, 26, 34, moved)[1].startswith("waits")
    assert len(closer.pending) == 2


def accept_some(closer: LoopCloser) -> FloatArray:
    """Four closures that agree; the poses (n, 3) after them."""
    for target, source in ((20, 40), (15, 45), (10, 50), (5, 55)):
        assert decide(closer, target, source, (0.0, 0.0, 0.0))[0]
    assert closer.reject_outliers() == []
    return closer.graph.poses()


def test_a_closure_that_the_others_contradict_is_rejected(stiff_closer: LoopCloser) -> None:
    closer, before = stiff_closer, accept_some(stiff_closer)
    assert decide(closer, 13, 47, (1.0, -2.0, 0.3), cov=25.0 * np.eye(3)) == (True, "accepted")
    assert np.abs(closer.graph.poses() - before).max() > 0.1
    (attempt,) = closer.reject_outliers()
    event = attempt.text
    text = "closure 13-47 rejected as an outlier: the rest of the graph contradicts it, squared residual "
    assert event.startswith(text)
    assert int(event.removeprefix(text)) > closer.config.max_residual2
    assert closures(closer) == [(20, 40), (15, 45), (10, 50), (5, 55)]
    assert [(c.target.anchor, c.source.anchor) for c, _ in closer.accepted] == closures(closer)
    assert max(errors(closer.graph.poses(), before)) < 5e-3
    assert closer.reject_outliers() == []


def test_several_wrong_closures_are_rejected_one_by_one(stiff_closer: LoopCloser) -> None:
    closer, before = stiff_closer, accept_some(stiff_closer)
    for target, source, moved in ((13, 47, (1.0, -2.0, 0.3)), (7, 53, (-2.0, 1.0, -0.2))):
        assert decide(closer, target, source, moved, cov=25.0 * np.eye(3))[0]
    events = closer.reject_outliers()
    assert sorted(event.text.split()[1] for event in events) == ["13-47", "7-53"]
    assert max(errors(closer.graph.poses(), before)) < 5e-3


def test_a_closure_that_only_bends_the_odometry_stays(closer: LoopCloser) -> None:
    assert decide(closer, 13, 47, (1.0, -2.0, 0.3), cov=25.0 * np.eye(3))[0]
    assert closer.reject_outliers() == []
    assert closures(closer) == [(13, 47)]
