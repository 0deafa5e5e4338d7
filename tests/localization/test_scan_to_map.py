import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.linalg import is_covariance
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import Estimate, ScanToMap, ScanToMapConfig
from slammot_graph.mapping.local_map import LocalMapConfig
from slammot_graph.odometry import Motion, OdometryNoise, WheelOdometry
from slammot_graph.odometry.motion import MatchedPose
from tests.rooms import CORRIDOR, drive, errors, kidnapped, occluded, odometry_of, truth_from_start

N_LOST = 3


@pytest.fixture
def localizer() -> Iterator[ScanToMap]:
    localizer = ScanToMap(
        WheelOdometry(OdometryNoise()),
        ScanToMapConfig(
            n_lost=N_LOST, close_loops=False, local_map=LocalMapConfig(max_keyframes=6, n_overlap=3)
        ),
    )
    yield localizer
    localizer.close()


def step(
    localizer: ScanToMap, scan: Scan, max_range: float = np.inf
) -> tuple[Estimate, Estimate, MatchResult | None, int | None, list[str]]:
    """Predicted, matched, match, node and events of one scan."""
    points, is_valid = scan.points_base(), scan.is_valid(max_range)
    predicted = localizer.predict(scan)
    matched, match = localizer.match(points, is_valid)
    committed = localizer.commit(scan, points, is_valid)
    assert all(event.scan == scan.index for event in committed.events)
    return predicted, matched, match, committed.node, [event.text for event in committed.events]


def test_room_is_followed_with_nodes_at_keyframes(localizer: ScanToMap) -> None:
    log = drive(60, with_person=False)
    truth, nodes = truth_from_start(log), []
    for k, scan in enumerate(log):
        predicted, matched, match, node, events = step(localizer, scan)
        T_map_base = se2.compose(localizer.T_map_local, matched.T_local_base)
        assert errors(truth[k], T_map_base)[0] < 0.02
        assert events == []
        if match is not None:
            assert match.status == "converged"
            assert np.trace(matched.cov_relative) < np.trace(predicted.cov_relative)
        if node is not None:
            nodes.append(k)
            assert node == len(nodes) - 1
    final = localizer.final()
    assert max(errors(truth, final.T_map_base)) < 0.02
    assert final.node_scans.tolist() == nodes
    np.testing.assert_allclose(final.T_map_base[nodes], final.nodes, atol=1e-9)
    # keyframes of 0.3 m on steps of 0.08 m, or of 0.2 rad on steps of 0.04 rad
    assert np.diff(nodes).tolist() == pytest.approx([4] * (len(nodes) - 1), abs=1)
    kinds = [edge.kind for edge in final.edges]
    assert kinds == ["odometry", "match"] * (len(nodes) - 1)
    assert all(edge.to_node == edge.from_node + 1 for edge in final.edges if edge.kind == "odometry")
    # the first map has nodes 0 to 5 and then is replaced by that of node 3
    anchors = [edge.from_node for edge in final.edges if edge.kind == "match"]
    assert anchors[:8] == [0, 0, 0, 0, 0, 3, 3, 3]
    assert all(is_covariance(cov) for cov in final.cov_map)
    assert len(localizer.graph) == len(nodes)


def test_covariance_relative_to_the_anchor_starts_anew_with_each_map(localizer: ScanToMap) -> None:
    relative, absolute = [], []
    for scan in drive(60, with_person=False):
        step(localizer, scan)
        estimate = localizer._estimate()
        relative.append(np.trace(estimate.cov_relative))
        absolute.append(np.trace(estimate.cov_absolute))
    assert max(relative[30:]) < 2.0 * max(relative[:30])
    assert absolute[-1] > relative[-1]


def test_covariances_of_the_first_map_last_into_the_final_ones(localizer: ScanToMap) -> None:
    online = [step(localizer, scan)[1].cov_absolute for scan in drive(14, with_person=False)]
    online_std, final_std = (
        np.sqrt(np.trace(cov, axis1=1, axis2=2)) for cov in (np.array(online), localizer.final().cov_map)
    )
    np.testing.assert_allclose(final_std, online_std, rtol=0.5)


def test_along_a_corridor_the_odometry_decides(localizer: ScanToMap) -> None:
    log = drive(40, walls=CORRIDOR, is_straight=True, with_person=False)
    odometry = np.array([scan.T_odom_base for scan in log])
    stds, along = [], 0.0
    before = np.zeros(3)
    for k, scan in enumerate(log):
        # near points only: those farther on stand alone, without a normal
        _, matched, match, _, _ = step(localizer, scan, max_range=4.5)
        if match is not None:
            assert match.status == "degenerate"
            along += (se2.rotation(before[2]) @ se2.between(odometry[k - 1], odometry[k])[:2])[0]
        before = matched.T_local_base
        stds.append(np.sqrt(matched.cov_absolute[0, 0]))
        assert matched.T_local_base[0] == pytest.approx(along, abs=0.01 + 0.03 * along)
        assert abs(matched.T_local_base[1]) < 0.02
        assert abs(matched.T_local_base[2]) < 0.02
    assert stds[-1] > 0.04
    assert stds[-1] > 1.5 * stds[10]
    assert np.sqrt(matched.cov_absolute[1, 1]) < 0.25 * stds[-1]
    final = localizer.final()
    assert max(errors(truth_from_start(log), final.T_map_base)) < 3 * stds[-1]


@pytest.mark.parametrize("seed", [0, 3])
def test_a_long_bare_corridor_at_full_range_keeps_to_the_odometry(localizer: ScanToMap, seed: int) -> None:
    log = drive(200, seed=seed, walls=CORRIDOR, is_straight=True, with_person=False)
    truth, along = truth_from_start(log), 0.0
    for k, scan in enumerate(log):
        heading = localizer.propagation.state.T_local_base[2]
        predicted, matched, match, _, events = step(localizer, scan)
        assert events == []
        if match is None:
            continue
        assert match.status == "degenerate"
        moved = se2.between(odometry_of(log.scans[k - 1]), odometry_of(scan))[:2]
        along += (se2.rotation(heading) @ moved)[0]
        x, y, theta = matched.T_local_base
        assert x == pytest.approx(along, abs=0.03 + 0.02 * along)
        assert max(abs(y), abs(theta)) < 0.02
        # it claims no more than the odometry knows along the corridor, and consistently
        assert matched.cov_relative[0, 0] > 0.9 * predicted.cov_relative[0, 0]
        assert abs(x - truth[k, 0]) < 3.0 * np.sqrt(matched.cov_absolute[0, 0]) + 0.01
    assert along > 15.0
    assert np.sqrt(localizer.final().cov_map[-1, 0, 0]) > 0.1


def test_an_occluded_scan_is_predicted_and_the_next_matched(localizer: ScanToMap) -> None:
    log = occluded(drive(20, with_person=False), 10)
    for k, scan in enumerate(log):
        predicted, matched, match, node, events = step(localizer, scan)
        if k == 10:
            assert match is not None
            assert match.status == "failed"
            np.testing.assert_array_equal(matched.T_local_base, predicted.T_local_base)
            np.testing.assert_allclose(matched.cov_relative, predicted.cov_relative, rtol=1e-9)
            assert events == ["match failed: only 0 points found a partner"]
        elif k > 10:
            assert match is not None
            assert match.status == "converged"
            assert node != 0
    assert max(errors(truth_from_start(log), localizer.final().T_map_base)) < 0.03


def test_an_occluded_laser_keeps_its_local_map(localizer: ScanToMap) -> None:
    log = occluded(drive(30, with_person=False), *range(8, 8 + 4 * N_LOST))
    for k, scan in enumerate(log):
        before = localizer.local_map.anchor.node if k else 0
        _, _, match, node, events = step(localizer, scan)
        if 8 <= k < 8 + 4 * N_LOST:
            assert events == ["match failed: only 0 points found a partner"]
            assert node is None
            assert localizer.local_map.anchor.node == before
        elif k:
            assert match is not None
            assert match.status == "converged"
            assert events == []
    truth, found = truth_from_start(log), localizer.final().T_map_base
    assert max(errors(truth[8:20], found[8:20])) < 0.1  # on the odometry alone
    assert max(errors(truth[20:], found[20:])) < 0.02


def test_failures_in_a_row_start_a_new_local_map(localizer: ScanToMap) -> None:
    log, events = kidnapped(drive(40, with_person=False), 5), {}
    for k, scan in enumerate(log):
        _, _, match, node, told = step(localizer, scan)
        if told:
            events[k] = told
        if k == 7:
            assert [key.node for key in localizer.local_map.keyframes] == [len(localizer.graph) - 1]
            assert node == len(localizer.graph) - 1
        elif k > 7:
            assert match is not None
            assert match.status == "converged"
    assert sorted(events) == [5, 6, 7]
    assert events[5][0].startswith("match failed: only ")
    assert [len(told) for told in events.values()] == [1, 1, 2]
    assert events[7][1] == f"lost: {N_LOST} matches failed in a row, a new local map begins here"
    final, truth = localizer.final(), truth_from_start(log)
    # whole in itself after the loss, and the motion between is the odometry's
    after = se2.between(final.T_map_base[7], final.T_map_base[7:])
    assert max(errors(se2.between(truth[7], truth[7:]), after)) < 0.02
    assert errors(truth, final.T_map_base)[0] < 0.1
    # the map of the hall may lie anywhere: that is what the covariance says
    std = np.sqrt(np.diagonal(final.cov_map, axis1=1, axis2=2))
    assert (std[7:, :2] > 2.5).all()
    assert (std[:5] < 0.05).all()


def test_an_occluded_scan_does_not_count_between_failures(localizer: ScanToMap) -> None:
    log, lost = occluded(kidnapped(drive(20, with_person=False), 5), 6), []
    for k, scan in enumerate(log):
        lost += [k for text in step(localizer, scan)[4] if text.startswith("lost")]
    assert lost == [8]


def test_nothing_yet_is_an_empty_trajectory(localizer: ScanToMap) -> None:
    final = localizer.final()
    assert final.T_map_base.shape == (0, 3)
    assert final.cov_map.shape == (0, 3, 3)
    assert (len(final.nodes), len(final.node_scans), final.edges) == (0, 0, ())


class PreviousMotion:
    """Without wheels: the motion is that of the scan before."""

    is_contradicted = False
    most_change_m = math.inf
    match_noise_scale = 1.0
    common_stds = np.zeros(4)

    def __init__(self) -> None:
        self.T_odom_base: FloatArray = np.zeros(3)
        self._T_local_base: FloatArray | None = None
        self._increment: FloatArray = np.zeros(3)

    def advance(self, scan: Scan) -> Motion | None:
        if self._T_local_base is None:
            return None
        self.T_odom_base = se2.compose(self.T_odom_base, self._increment)
        return Motion(increment=self._increment, cov=np.diag([0.05, 0.05, 0.05]) ** 2)

    def during_sweep(self, scan: Scan) -> SweepMotion:
        raise AssertionError("these scans are snapshots")

    def correct(self, T_local_base: FloatArray, match: MatchedPose | None) -> None:
        if self._T_local_base is not None:
            self._increment = se2.between(self._T_local_base, T_local_base)
        self._T_local_base = T_local_base

    def report(self) -> OdometryReport:
        return OdometryReport()


def test_another_motion_model_takes_the_place_of_the_wheels() -> None:
    """The scans' odometry is not read by any other part."""
    log = drive(60, with_person=False)
    localizer = ScanToMap(PreviousMotion(), ScanToMapConfig())
    for k, scan in enumerate(log):
        _, _, match, _, texts = step(localizer, replace(scan, T_odom_base=np.full(3, np.nan)))
        assert texts == []
        assert match is None if k == 0 else match is not None
    final = localizer.final()
    localizer.close()
    assert max(errors(truth_from_start(log), final.T_map_base)) < 0.02
    assert all(is_covariance(cov) for cov in final.cov_map)


def test_a_commit_tells_of_keyframes_and_losses(localizer: ScanToMap) -> None:
    log, committed = kidnapped(drive(20, with_person=False), 5), []
    for scan in log:
        points, is_valid = scan.points_base(), scan.is_valid()
        localizer.predict(scan)
        localizer.match(points, is_valid)
        committed.append(localizer.commit(scan, points, is_valid))
    assert [k for k, result in enumerate(committed) if result.is_lost] == [7]
    assert [event.severity for event in committed[7].events] == ["warning", "error"]
    assert committed[7].events[1].data == {"cause": "failed matches", "n_scans": N_LOST}
    assert committed[0].is_keyframe
    assert committed[7].is_keyframe
    assert all(result.is_keyframe == (result.node is not None) for result in committed)
    assert all(result.closures == () for result in committed)
    assert localizer.insertion.n_times_lost == 1
