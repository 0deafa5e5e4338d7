"""A robot that is carried while its laser is covered, and finds itself again."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.run import Run
from slammot_graph.simulation import SimulatedLog, simulate
from tests.loop_closure.ring import closure_errors, true_path

N_COVERED = 10


def carried(log: SimulatedLog, start: int, end: int) -> SimulatedLog:
    """The way from scan `start` to scan `end` is left out: the odometry does not know, the laser is covered."""
    row = np.r_[np.arange(start), np.full(N_COVERED, start), np.arange(end, log.n_scans)]
    ranges, T_odom_base = log.ranges[row].copy(), log.T_odom_base[row].copy()
    ranges[start : start + N_COVERED] = log.laser.range_max
    driven = se2.between(log.T_odom_base[end], log.T_odom_base[end:])
    T_odom_base[start + N_COVERED :] = se2.compose(log.T_odom_base[start], driven)
    return SimulatedLog(
        name="carried",
        laser=log.laser,
        stamps=0.1 * np.arange(len(row)),
        ranges=ranges,
        T_odom_base=T_odom_base,
        T_world_base=log.T_world_base[row],
        is_moving=log.is_moving[row],
        object_id=log.object_id[row],
        objects=log.objects[row],
    )


@cache
def carried_in_the_lab(seed: int) -> tuple[SimulatedLog, int]:
    """3 m straight on in the second lap of three, and the first scan after it."""
    log = simulate("lab", seed=seed, n_people=0, n_laps=3)
    for start in range(400, log.n_scans):
        way = se2.between(log.T_world_base[start], log.T_world_base[start:])
        end = int(np.argmax(np.hypot(way[:, 0], way[:, 1]) >= 3.0))
        if end and abs(way[end, 2]) < 0.15:
            return carried(log, start, start + end), start + N_COVERED
    raise AssertionError("there is no straight way of 3 m")


def distances(log: SimulatedLog, T_map_base: FloatArray) -> FloatArray:
    apart = se2.between(true_path(log), T_map_base)
    return np.hypot(apart[:, 0], apart[:, 1])


@pytest.mark.parametrize("seed", [1, 2])
def test_a_carried_robot_knows_that_it_is_lost_and_finds_itself_again(seed: int) -> None:
    log, back = carried_in_the_lab(seed)
    run, steps = Run(log), list[StepResult]()
    for step in run:
        steps.append(step)
    result = run.result()

    # in the dark nothing is decided, then the matches fail
    assert all(
        [event.text for event in step.events] == ["match failed: only 0 points found a partner"]
        for step in steps[back - 10 : back]
    )
    (lost,) = (scan for scan, text in result.events if text.startswith("lost: "))
    assert lost == back
    assert all(step.match is not None and step.match.status == "failed" for step in steps[back : lost + 1])
    assert not any(step.is_moving.any() for step in steps[back : lost + 1])

    # a new local map, of which it is not known where it lies
    std_m = np.sqrt([step.cov_map[:2, :2].trace() for step in steps])
    assert std_m[: back - 10].max() < 0.1
    assert std_m[lost + 1] > 3.0
    assert all(
        step.match is not None and step.match.status == "converged" for step in steps[lost + 1 : lost + 50]
    )

    # until it is recognised: a closure between the new map and the old one
    first_new = next(k for k, scan in enumerate(result.node_scans) if scan >= lost)
    joints = [e for e in result.edges if e.kind == "closure" and e.from_node < first_new <= e.to_node]
    assert joints
    wrong = closure_errors(log, result)
    assert wrong[:, 0].max() < 0.1
    assert wrong[:, 1].max() < np.deg2rad(1.0)
    rejoined = next(
        k for k, text in result.events if k > lost and text.startswith("closure") and "accepted" in text
    )
    assert std_m[lost + 1 : rejoined].min() > 3.0
    assert std_m[rejoined + 1 :].max() < 0.1
    online = np.array([step.T_map_base for step in steps])
    assert distances(log, online)[lost + 1 : rejoined].min() > 2.5
    assert distances(log, online)[rejoined + 1 :].max() < 0.1
    assert distances(log, result.T_map_base)[lost:].max() < 0.1
    assert distances(log, result.T_map_base)[: back - 10].max() < 0.05


def test_a_jump_comes_with_no_object_and_leaves_no_ghosts() -> None:
    """Nobody is about: neither before nor after the way in the dark does anything seem to move."""
    log, back = carried_in_the_lab(1)
    result = Run(log).complete()
    share = result.is_moving.sum(axis=1) / result.is_valid.sum(axis=1).clip(1)
    assert share[back : back + 60].mean() < 0.02
    assert share.mean() < 0.01


def test_events_of_a_run_come_in_the_order_of_the_scans() -> None:
    log, _ = carried_in_the_lab(1)
    events = Run(log).complete().events
    assert all(a[0] <= b[0] for a, b in pairwise(events))
