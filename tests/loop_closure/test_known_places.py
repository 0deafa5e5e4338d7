"""Laps in known places are merged into these, and the graph stays one that can be solved."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph, PoseGraphConfig
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.known_places import AWAY_M, MIN_VISITS, N_RECENT, KnownPlaces
from slammot_graph.loop_closure.submap import Place

N_OF_LAP = 12
STEP = np.array([1.0, 0.0, 2.0 * np.pi / N_OF_LAP])
STD = np.array([0.02, 0.02, 0.01])
INFORMATION = np.diag(STD**-2.0)


def place(node: int) -> Place:
    return Place(number=node, anchor=node, path_m=2.0 * AWAY_M / N_OF_LAP * node, component=0)


class Lapping:
    """A robot on a circle: a node for each place of it, and a closure of each later one with that of the first lap."""

    def __init__(self, *, merges: bool, targets: range = range(N_OF_LAP)) -> None:
        self.graph = PoseGraph(PoseGraphConfig())
        self.known = KnownPlaces(self.graph)
        self.accepted: list[tuple[Closure, GraphEdge]] = []
        self.merges, self.targets = merges, targets

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
        self.known.see(closure)
        self.graph.update()
        if self.merges:
            self.known.settle(node, self.accepted, self.targets)


@pytest.fixture(scope="module")
def both() -> tuple[Lapping, Lapping, FloatArray]:
    merged, tied = Lapping(merges=True), Lapping(merges=False)
    truth = merged.drive(MIN_VISITS + 4)
    tied.drive(MIN_VISITS + 4)
    return merged, tied, truth


def test_nothing_is_merged_before_places_are_known_well() -> None:
    merged, tied = Lapping(merges=True), Lapping(merges=False)
    merged.drive(MIN_VISITS + 1)
    tied.drive(MIN_VISITS + 1)
    np.testing.assert_array_equal(merged.graph.poses(), tied.graph.poses())


def test_late_laps_are_merged_into_the_first_one(both: tuple[Lapping, Lapping, FloatArray]) -> None:
    merged, *_ = both
    n = len(merged.graph)
    # all but the well-known first laps, those at the first and at the latest cut, and the latest local maps
    assert merged.graph.n_merged == n - (MIN_VISITS + 1) * N_OF_LAP - N_RECENT - 1
    gone = set(range(n)) - {node for e in merged.graph.edges for node in (e.from_node, e.to_node)}
    assert len(gone) == merged.graph.n_merged
    for edge in merged.graph.all_edges[len(merged.graph.edges) :]:
        assert (edge.kind, edge.from_node) == ("closure", edge.to_node % N_OF_LAP)
        gone.remove(edge.to_node)
    assert not gone
    # what is final is not judged again
    assert {closure.source.anchor for closure, _ in merged.accepted} <= {
        node for e in merged.graph.edges for node in (e.from_node, e.to_node)
    }


def test_each_node_stays_tied_to_an_earlier_one(both: tuple[Lapping, Lapping, FloatArray]) -> None:
    merged, *_ = both
    ends = {max(e.from_node, e.to_node) for e in merged.graph.all_edges}
    assert ends == set(range(1, len(merged.graph)))


def test_poses_are_as_good_and_covariances_not_smaller(both: tuple[Lapping, Lapping, FloatArray]) -> None:
    merged, tied, truth = both
    off = se2.log(se2.between(truth, merged.graph.poses()))
    off_tied = se2.log(se2.between(truth, tied.graph.poses()))
    assert np.hypot(*off[:, :2].T).mean() < 1.1 * np.hypot(*off_tied[:, :2].T).mean()
    more = merged.graph.marginals() - tied.graph.marginals()
    assert np.linalg.eigvalsh(more).min() > -1e-7
    nees = np.einsum("ki,kij,kj->k", off[1:], np.linalg.inv(merged.graph.marginals()[1:]), off[1:])
    assert nees.mean() < 3.0 * 1.5


def test_where_others_are_compared_with_it_nothing_is_merged() -> None:
    lapping = Lapping(merges=True, targets=range(10_000))
    lapping.drive(MIN_VISITS + 3)
    assert lapping.graph.n_merged == 0


def test_who_stays_has_not_come_back() -> None:
    known, own = KnownPlaces(PoseGraph(PoseGraphConfig())), Lapping(merges=False)
    own.drive(2)
    first = own.accepted[0][0]
    for path_m in (30.0, 35.0, 54.0, 73.0, 94.0):
        known.see(replace(first, source=first.source._replace(path_m=path_m)))
    assert known.visits[first.target.anchor] == 2
