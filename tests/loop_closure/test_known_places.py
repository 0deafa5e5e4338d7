"""Laps in known places are tied to these alone, and the graph stays one that can be solved."""

from collections.abc import Iterator

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from slammot_graph.loop_closure import known_places
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.known_places import N_RECENT, KnownPlaces
from slammot_graph.loop_closure.submap import Place

N_OF_LAP = 12
MIN_VISITS = 6
STEP = np.array([1.0, 0.0, 2.0 * np.pi / N_OF_LAP])
STD = np.array([0.02, 0.02, 0.01])
INFORMATION = np.diag(STD**-2.0)


def place(node: int) -> Place:
    return Place(number=node, anchor=node, path_m=float(node), component=0)


class Lapping:
    """A robot on a circle: a node for each place of it, and a closure of each later one with that of the first lap."""

    def __init__(self, *, cuts: bool) -> None:
        self.graph = PoseGraph(PoseGraphConfig())
        self.known = KnownPlaces(self.graph)
        self.accepted: list[tuple[Closure, GraphEdge]] = []
        self.cuts = cuts

    def drive(self, n_laps: int) -> FloatArray:
        """(n,) true poses of all nodes."""
        rng = np.random.default_rng(0)
        truth = [np.zeros(3)]
        self.graph.start(truth[0])
        for node in range(1, n_laps * N_OF_LAP):
            truth.append(se2.compose(truth[-1], STEP))
            T = se2.compose(STEP, rng.normal(size=3) * STD)
            self.graph.add_node(se2.compose(self.graph.pose(node - 1), T))
            self.graph.add_edge("odometry", node - 1, node, T, INFORMATION)
            if node >= N_OF_LAP:
                self.close(node, truth, rng)
        self.graph.update()
        return np.array(truth)

    def close(self, node: int, truth: list[FloatArray], rng: np.random.Generator) -> None:
        T = se2.compose(se2.between(truth[node % N_OF_LAP], truth[node]), rng.normal(size=3) * STD)
        edge = self.graph.add_edge("closure", node % N_OF_LAP, node, T, INFORMATION)
        closure = Closure(
            target=place(node % N_OF_LAP),
            source=place(node),
            T_target_source=T,
            cov=np.diag(STD**2),
            information=INFORMATION,
            overlap=0.9,
        )
        self.accepted.append((closure, edge))
        self.known.visits[node % N_OF_LAP] += 1
        self.graph.update()
        if self.cuts:
            self.known.settle(node, self.accepted)


@pytest.fixture(scope="module", autouse=True)
def few_visits() -> Iterator[None]:
    """Fewer than usual: the graph that stays tied takes long to solve."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(known_places, "MIN_VISITS", MIN_VISITS)
        yield


@pytest.fixture(scope="module")
def both() -> tuple[Lapping, Lapping, FloatArray]:
    cut, tied = Lapping(cuts=True), Lapping(cuts=False)
    truth = cut.drive(MIN_VISITS + 4)
    tied.drive(MIN_VISITS + 4)
    return cut, tied, truth


def test_nothing_is_cut_before_places_are_known_well() -> None:
    cut, tied = Lapping(cuts=True), Lapping(cuts=False)
    cut.drive(MIN_VISITS + 1)
    tied.drive(MIN_VISITS + 1)
    np.testing.assert_array_equal(cut.graph.poses(), tied.graph.poses())


def test_a_late_lap_hangs_on_the_first_one_and_nothing_else_is_gone(
    both: tuple[Lapping, Lapping, FloatArray],
) -> None:
    cut, tied, _ = both
    gone = {(e.kind, e.from_node, e.to_node) for e in tied.graph.edges}
    gone -= {(e.kind, e.from_node, e.to_node) for e in cut.graph.edges}
    assert len(gone) > N_OF_LAP
    assert {kind for kind, *_ in gone} == {"odometry"}
    n = len(cut.graph)
    ends = {to for _, _, to in gone}
    assert ends <= set(range(MIN_VISITS * N_OF_LAP, n - N_RECENT))
    # what is final is not judged again
    assert not ends & {closure.source.anchor for closure, _ in cut.accepted}


def test_each_node_stays_tied_to_an_earlier_one(both: tuple[Lapping, Lapping, FloatArray]) -> None:
    cut, *_ = both
    ends = {max(e.from_node, e.to_node) for e in cut.graph.edges}
    assert ends == set(range(1, len(cut.graph)))


def test_poses_are_as_good_and_covariances_not_smaller(both: tuple[Lapping, Lapping, FloatArray]) -> None:
    cut, tied, truth = both
    off = se2.log(se2.between(truth, cut.graph.poses()))
    off_tied = se2.log(se2.between(truth, tied.graph.poses()))
    assert np.hypot(*off[:, :2].T).mean() < 1.3 * np.hypot(*off_tied[:, :2].T).mean()
    more = cut.graph.marginals() - tied.graph.marginals()
    assert np.linalg.eigvalsh(more).min() > -1e-7
    nees = np.einsum("ki,kij,kj->k", off[1:], np.linalg.inv(cut.graph.marginals()[1:]), off[1:])
    assert nees.mean() < 3.0 * 1.5
