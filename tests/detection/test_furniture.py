"""Final labels of a run: what was static at other times is furniture, whoever came and stands is not."""

from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.furniture import without_furniture
from slammot_graph.detection.hit_memory import HitMemoryConfig
from slammot_graph.detection.scan_history import ScanRecord
from tests.rooms import box, is_person, take_scan

N = 120
ROOM = box(-4.0, -3.0, 6.0, 3.5)
LEG = [2.0, 1.0, 0.08]


def record(k: int, *, sees_leg: bool, stamp: float | None = None) -> ScanRecord:
    scan = take_scan(np.zeros(3), index=k, walls=ROOM, discs=[LEG] if sees_leg else [])
    scan = scan if stamp is None else replace(scan, stamp=stamp)
    nothing = np.zeros(len(scan.ranges), dtype=np.bool_)
    return ScanRecord(
        scan=scan,
        is_valid=scan.is_valid(),
        is_moving=nothing,
        is_wall=nothing,
        is_displaced=nothing,
        is_lasting=nothing,
        is_sure=nothing,
        cov_relative=1e-6 * np.eye(3),
        window=0,
        is_doubtful=False,
    )


def judge(history: list[ScanRecord], labels: list[BoolArray]) -> list[BoolArray]:
    poses = np.tile(se2.IDENTITY, (len(history), 1))
    return without_furniture(
        labels,
        history,
        poses,
        config=HitMemoryConfig(),
        clusters=ClusterConfig(),
        resolution_m=0.1,
    )


def sees_leg_now_and_then() -> list[ScanRecord]:
    return [record(k, sees_leg=k % 8 == 0) for k in range(N)]


def test_a_leg_called_moving_now_and_then_is_furniture() -> None:
    history = sees_leg_now_and_then()
    labels = [is_person(item.scan) & (k % 24 == 0) for k, item in enumerate(history)]
    assert sum(label.sum() for label in labels) >= 10
    assert not any(label.any() for label in judge(history, labels))


def test_hits_after_it_tell_as_those_before() -> None:
    history = sees_leg_now_and_then()
    for k in (0, N - 8):
        labels = [is_person(item.scan) & (j == k) for j, item in enumerate(history)]
        assert labels[k].any()
        assert not judge(history, labels)[k].any()


def test_who_was_there_once_moved() -> None:
    history = [record(k, sees_leg=40 <= k < 50) for k in range(N)]
    labels = [is_person(item.scan) for item in history]
    for before, after in zip(labels, judge(history, labels), strict=True):
        np.testing.assert_array_equal(after, before)


def test_who_comes_and_stands_is_not_judged_by_his_own_hits() -> None:
    history = [record(k, sees_leg=40 <= k < 65) for k in range(N)]
    labels = [is_person(item.scan) & (k < 55) for k, item in enumerate(history)]
    after = judge(history, labels)
    np.testing.assert_array_equal(after[40], labels[40])
    assert labels[40].any()


def test_an_object_that_displaced_needs_more_hits() -> None:
    history = sees_leg_now_and_then()
    labels = [is_person(item.scan) & (k == 56) for k, item in enumerate(history)]
    assert not judge(history, labels)[56].any()
    history[56] = replace(history[56], is_displaced=labels[56])
    np.testing.assert_array_equal(judge(history, labels)[56], labels[56])


def test_labels_without_moving_points_stay() -> None:
    history = sees_leg_now_and_then()[:5]
    labels = [np.zeros(len(item.scan.ranges), dtype=np.bool_) for item in history]
    assert all(not label.any() for label in judge(history, labels))
    assert judge([], []) == []


def test_a_crowd_is_not_judged() -> None:
    history = sees_leg_now_and_then()
    crowd = [*range(40), *range(80, len(history[0].is_valid))]
    labels = [is_person(item.scan) & (k == 56) for k, item in enumerate(history)]
    labels[56][crowd] = history[56].is_valid[crowd]
    np.testing.assert_array_equal(judge(history, labels)[56], labels[56])
