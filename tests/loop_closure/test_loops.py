"""Whole runs that come back to where they were."""

from functools import cache

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import ScanToMap
from slammot_graph.pipeline import Pipeline
from slammot_graph.run import Run
from slammot_graph.simulation import SimulatedLog, simulate
from tests.loop_closure.ring import closure_errors, ring_log, true_path
from tests.rooms import errors


@cache
def ring_run(seed: int, method: str = "graph") -> RunResult:
    return Run(ring_log(seed), method).complete()


def distances(log: SimulatedLog, result: RunResult) -> FloatArray:
    """(n,) distance [m] of each pose from the true one."""
    apart = se2.between(true_path(log), result.T_map_base)
    return np.hypot(apart[:, 0], apart[:, 1])


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_a_ring_is_closed_and_every_closure_is_right(seed: int) -> None:
    log, result = ring_log(seed), ring_run(seed)
    odometry = se2.between(log.T_odom_base[0], log.T_odom_base)
    assert errors(true_path(log), odometry)[0] > 3.0  # what there was to mend
    wrong = closure_errors(log, result)
    assert len(wrong) >= 5
    assert wrong[:, 0].max() < 0.05
    assert wrong[:, 1].max() < np.deg2rad(0.6)
    assert distances(log, result).max() < 0.3


def test_closures_make_the_trajectory_better() -> None:
    squares = {
        method: np.concatenate([distances(ring_log(k), ring_run(k, method)) ** 2 for k in (0, 1, 4)])
        for method in ("graph", "graph-noloop")
    }
    assert np.sqrt(squares["graph"].mean()) < 0.9 * np.sqrt(squares["graph-noloop"].mean())


def test_a_second_lap_meets_the_first() -> None:
    """Places that were passed twice lie nearer to each other than without closures."""
    log, lapse = ring_log(4), []
    start = true_path(log)
    for method in ("graph", "graph-noloop"):
        found = ring_run(4, method).T_map_base
        again = [
            (k, m)
            for m in range(260, len(start), 10)
            for k in [int(np.argmin(np.hypot(*(start[:200, :2] - start[m, :2]).T)))]
        ]
        assert len(again) > 10
        early, late = np.array(again).T
        apart = se2.between(se2.between(start[early], start[late]), se2.between(found[early], found[late]))
        lapse.append(np.hypot(apart[:, 0], apart[:, 1]).max())
    assert lapse[0] < 0.05
    assert lapse[0] < 0.5 * lapse[1]


def test_events_tell_of_each_closure() -> None:
    result = ring_run(1)
    told = [
        f"{event.data['target_node']}-{event.data['source_node']}"
        for event in result.events
        if event.kind == "closure accepted"
    ]
    assert not any(event.kind == "closure rejected" for event in result.events)
    edges = [f"{e.from_node}-{e.to_node}" for e in result.edges if e.kind == "closure"]
    assert len(edges) >= 5
    assert sorted(told) == sorted(edges)


def test_no_closure_without_a_closer() -> None:
    result = ring_run(1, "graph-noloop")
    assert not any(edge.kind == "closure" for edge in result.edges)
    assert not any(event.kind.startswith("closure") for event in result.events)


def test_covariances_shrink_where_a_loop_is_closed() -> None:
    closed, open_ = (ring_run(1, method).cov_map[-1] for method in ("graph", "graph-noloop"))
    assert np.trace(closed[:2, :2]) < 0.5 * np.trace(open_[:2, :2])
    apart = se2.log(se2.between(true_path(ring_log(1))[-1], ring_run(1).T_map_base[-1]))
    # with the known optimism of matches that share errors (`drift_scale`)
    assert apart @ np.linalg.solve(closed, apart) < 16.0 * 5.0**2


@pytest.mark.parametrize(("seed", "n_people"), [(1, 0), (2, 3)])
def test_the_lab_driven_twice_is_closed_rightly(seed: int, n_people: int) -> None:
    log = simulate("lab", seed=seed, n_people=n_people)
    closed, open_ = (Run(log, method).complete() for method in ("graph", "graph-noloop"))
    wrong = closure_errors(log, closed)
    assert len(wrong) >= 8
    assert wrong[:, 0].max() < 0.1
    assert wrong[:, 1].max() < np.deg2rad(1.0)
    assert distances(log, closed).max() < 0.05
    assert distances(log, closed).mean() < 1.1 * distances(log, open_).mean()


def test_in_a_known_place_the_graph_gets_few_nodes_and_no_worse() -> None:
    """A third lap adds hardly more nodes than local maps, and each of these is attached to one."""
    log = simulate("lab", seed=1, n_people=0, n_laps=3)
    run = Run(log, "graph")
    nodes, known = [], []
    for step in run:
        assert isinstance(run.pipeline, Pipeline)
        localizer = run.pipeline.localizer
        assert isinstance(localizer, ScanToMap)
        assert localizer.closer is not None
        nodes.append(step.node is not None)
        known.append(localizer.closer.is_known)
        assert localizer.local_map.anchor.node >= 0
    result = run.result()
    first, _, last = np.array_split(nodes, 3)
    assert not any(known[: len(first) // 2])
    assert np.mean(np.array_split(known, 3)[2]) > 0.8
    assert np.sum(last) < 0.4 * np.sum(first)
    assert [int(k) for k in np.flatnonzero(nodes)] == result.node_scans.tolist()
    assert distances(log, result).max() < 0.03
    assert closure_errors(log, result)[:, 0].max() < 0.05


def test_a_run_twice_is_bit_equal_with_closures() -> None:
    first, again = ring_run(1), Run(ring_log(1), "graph").complete()
    assert sum(edge.kind == "closure" for edge in first.edges) >= 5
    for name in ("T_map_base", "cov_map", "is_moving", "p_moving", "tracks", "nodes", "nis"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(first.grid.p_occupied, again.grid.p_occupied)
    assert first.events == again.events
    for one, other in zip(first.edges, again.edges, strict=True):
        np.testing.assert_array_equal(one.T_from_to, other.T_from_to)
        np.testing.assert_array_equal(one.information, other.information)
