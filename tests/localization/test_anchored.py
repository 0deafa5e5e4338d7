"""What a step says of the pose relative to the anchor's scan."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.results import StepResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.methods import get_method
from slammot_graph.odometry.adaptive import AdaptiveOdometry
from slammot_graph.odometry.motion import Motion
from slammot_graph.pipeline import Pipeline, PipelineConfig
from tests.rooms import ROOM, ListLog, box, drive, occluded, truth_from_start

N_SCANS = 70
EMPTY_ROOM = ROOM[:4]


def steps_of(log: ListLog) -> tuple[list[StepResult], FloatArray]:
    """All steps, and the optimised trajectory."""
    config = get_method("graph-noloop").config
    assert isinstance(config, PipelineConfig)
    pipeline = Pipeline(config)
    try:
        return [pipeline.step(scan) for scan in log], pipeline.final().T_map_base
    finally:
        pipeline.close()


@pytest.fixture(scope="module")
def room() -> Iterator[tuple[ListLog, list[StepResult], FloatArray]]:
    log = drive(N_SCANS, with_person=False)
    yield log, *steps_of(log)


Room = tuple[ListLog, list[StepResult], FloatArray]


def is_positive(matrix: FloatArray) -> bool:
    return bool(np.linalg.eigvalsh(matrix)[0] > -1e-12)


def test_the_anchor_is_an_earlier_scan_and_moves_on(room: Room) -> None:
    steps = room[1]
    anchors = [step.anchor_scan for step in steps]
    assert anchors[0] == -1
    assert anchors[1] == 0
    assert all(anchor < step.scan.index for anchor, step in zip(anchors, steps, strict=True))
    assert anchors[1:] == sorted(anchors[1:])
    assert len(set(anchors[1:])) >= 2
    nodes = {step.scan.index for step in steps if step.node is not None}
    assert set(anchors[1:]) <= nodes


def test_poses_relative_to_the_anchor_agree_with_the_trajectory(room: Room) -> None:
    log, steps, T_map_base = room
    truth = truth_from_start(log)
    for step in steps[1:]:
        k, anchor = step.scan.index, step.anchor_scan
        for trajectory, within in ((T_map_base, 0.01), (truth, 0.02)):
            apart = se2.between(se2.between(trajectory[anchor], trajectory[k]), step.T_anchor_base)
            assert math.hypot(*apart[:2]) < within
            assert abs(apart[2]) < within
        # as the pose in the map has it that was best known at the time
        assert step.match is not None
        np.testing.assert_allclose(step.T_anchor_base, step.match.T_ref_base, atol=0.01)


def test_its_covariance_contains_what_is_correlated(room: Room) -> None:
    for step in room[1][1:]:
        assert step.match is not None
        assert np.abs(step.match.cov_correlated).max() > 0.0
        assert is_positive(step.cov_anchor_base - step.match.cov_correlated)
        assert np.linalg.eigvalsh(step.cov_anchor_base)[0] > 0.0


def test_the_tests_covariance_contains_that_of_the_match_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Predicted from the scan before, which has errors correlated with others', along the motion model's motion."""
    motions, advance = list[Motion | None](), AdaptiveOdometry.advance

    def recorded(self: AdaptiveOdometry, scan: Scan) -> Motion | None:
        motions.append(advance(self, scan))
        return motions[-1]

    monkeypatch.setattr(AdaptiveOdometry, "advance", recorded)
    steps, _ = steps_of(drive(N_SCANS, with_person=False))
    n_tested = 0
    for (before, step), motion in zip(itertools.pairwise(steps[1:]), motions[2:], strict=True):
        assert before.match is not None
        assert motion is not None
        assert is_positive(step.cov_relative - before.match.cov_correlated)
        if step.anchor_scan == before.anchor_scan and before.node is None:
            independent = before.cov_anchor_base - before.match.cov_correlated
            expected = se2.compound_covariance(independent, motion.increment, motion.cov)
            expected = expected + before.match.cov_correlated
            np.testing.assert_allclose(step.cov_relative, expected, rtol=1e-9, atol=1e-15)
            n_tested += 1
    assert n_tested > N_SCANS // 2


def test_a_scan_without_a_match_keeps_what_was_correlated(room: Room) -> None:
    occluded_at = 12
    steps, _ = steps_of(occluded(drive(20, with_person=False), occluded_at))
    failed = steps[occluded_at]
    assert failed.match is not None
    assert failed.match.status == "failed"
    np.testing.assert_allclose(failed.cov_anchor_base, failed.cov_relative, rtol=1e-9)
    before = steps[occluded_at - 1].match
    assert before is not None
    assert is_positive(failed.cov_anchor_base - before.cov_correlated)
    assert np.trace(failed.cov_anchor_base) > np.trace(steps[occluded_at - 1].cov_anchor_base)


def test_poses_err_as_much_as_they_say() -> None:
    """Normalised squares over several drives in rooms of different furniture, of 3 degrees of freedom."""
    samples = []
    for seed in range(6):
        x = 0.5 * seed
        walls = np.vstack([EMPTY_ROOM, box(-5 + x, -3, -4 + x, -2.4), box(4.2, 2 - 0.5 * x, 5, 3 - 0.5 * x)])
        log = drive(N_SCANS, seed=seed, walls=walls, with_person=False)
        rng = np.random.default_rng(100 + seed)
        for scan in log:
            scan.ranges[:] += rng.normal(0.0, 0.016, len(scan.ranges))
        steps, truth = steps_of(log)[0], truth_from_start(log)
        for step in steps[1:]:
            true = se2.between(truth[step.anchor_scan], truth[step.scan.index])
            error = se2.log(se2.between(step.T_anchor_base, true))
            samples.append(error @ np.linalg.solve(step.cov_anchor_base, error))
    assert 3.0 / 1.6 < np.mean(samples) < 3.0 * 1.6
