"""People who walk where nothing was seen before, who stand, and poses too doubtful to tell."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.results import StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig, LocalGridConfig, RetestConfig
from slammot_graph.detection.ellipse_test import EllipseTestConfig
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.mapping.occupancy_grid import NoReturnConfig
from slammot_graph.odometry.adaptive import AdaptiveOdometryConfig
from slammot_graph.odometry.doubt import DoubtConfig
from slammot_graph.pipeline import Pipeline, PipelineConfig
from slammot_graph.simulation import simulate
from slammot_graph.tracking.tracker import KalmanTrackerConfig
from tests.rooms import LASER, box, drive, errors, is_person, odometry_of, take_scan, truth_from_start

# a yard: behind y = 2 there are walls on the left only, on the right nothing within the laser's range
YARD = np.vstack([[[-6, 4, 0, 4], [-6, -4, -6, 4], [-6, -4, 6, -4], [6, -4, 6, 0]], box(-4, -3, -3, -2)])
BLIND_TO_NO_RETURNS = EllipseDetectorConfig(local_grid=LocalGridConfig(no_return=None))
QUIET = PipelineConfig(detector=BLIND_TO_NO_RETURNS)  # open space stays unknown
N_EMPTY = 20


def watch(people: FloatArray, config: PipelineConfig) -> list[StepResult]:
    """A robot that stands in the yard; `people` (n, k, 2), after some scans without."""
    rng, pipeline, steps = np.random.default_rng(0), Pipeline(config), []
    nobody = np.full((N_EMPTY, people.shape[1], 2), 99.0)
    for k, places in enumerate(np.concatenate([nobody, people])):
        scan = take_scan(
            np.array([0.0, 0.0, np.pi / 2]),
            index=k,
            walls=YARD,
            discs=[[*place, 0.25] for place in places],
            noise=rng.normal(0.0, 0.008, LASER.n_beams),
        )
        steps.append(pipeline.step(scan))
    pipeline.close()
    return steps


def recall(steps: list[StepResult], person: int, xs: FloatArray, low: float, high: float) -> float:
    """Share of a person's beams called moving while he is between two x."""
    found = seen = 0
    for step, x in zip(steps[N_EMPTY:], xs, strict=True):
        if low < x < high:
            assert step.scan.truth is not None
            assert step.scan.truth.object_id is not None
            truth = step.scan.truth.object_id == person
            seen += truth.sum()
            found += (truth & step.is_moving).sum()
    assert seen > 40
    return found / seen


WALK_X = np.arange(-3.0, 3.5, 0.1)
WALK = np.column_stack([WALK_X, np.full(len(WALK_X), 2.0)])[:, None]


def test_who_walks_into_the_unknown_stays_moving() -> None:
    """As long as the track lives without a free cell to prove it."""
    for seconds, last_x in ((1.0, 0.9), (3.0, 2.4)):
        steps = watch(WALK, replace(QUIET, tracker=KalmanTrackerConfig(max_missed_s=seconds)))
        assert recall(steps, 0, WALK_X, -2.0, -0.5) > 0.9
        assert recall(steps, 0, WALK_X, 0.4, last_x) > 0.9
    told = np.concatenate([step.reason[step.is_moving] for step in steps[-20:]])
    assert np.mean(told == reasons.TRACKED) > 0.5


def test_without_a_reach_nobody_moves_in_the_unknown() -> None:
    blind = replace(BLIND_TO_NO_RETURNS, ellipse_test=EllipseTestConfig(track_reach_m=None))
    steps = watch(WALK, replace(QUIET, detector=blind))
    assert recall(steps, 0, WALK_X, -2.0, -0.5) > 0.9
    assert recall(steps, 0, WALK_X, 0.4, 0.9) < 0.4


def test_who_never_walked_does_not_move() -> None:
    """He stands in the unknown while another walks by behind him."""
    still = np.broadcast_to([2.0, 1.2], (len(WALK_X), 1, 2))
    steps = watch(np.concatenate([WALK, still], axis=1), QUIET)
    assert recall(steps, 1, WALK_X, -3.1, 1.0) < 0.02
    assert recall(steps, 1, WALK_X, 1.0, 3.5) < 0.2


def test_open_space_that_returned_nothing_counts_as_free() -> None:
    detector = EllipseDetectorConfig(ellipse_test=EllipseTestConfig(track_reach_m=None))
    steps = watch(WALK, PipelineConfig(detector=detector))
    assert recall(steps, 0, WALK_X, 0.6, 2.4) > 0.9


def test_a_doubtful_pose_calls_nothing_moving() -> None:
    """The odometry jumps by 0.12 m, beyond the innovation's covariance, which nothing stretches, no doubt either."""
    log, jump = drive(50), np.array([0.12, 0.0, 0.0])
    before = odometry_of(log.scans[32])
    T_after_before = se2.compose(before, se2.compose(jump, se2.inverse(before)))
    log.scans[32:] = [
        replace(scan, T_odom_base=se2.compose(T_after_before, odometry_of(scan))) for scan in log.scans[32:]
    ]
    found = {}
    for nis in (15.0, 1e9):
        config = PipelineConfig(
            detector=EllipseDetectorConfig(retest=RetestConfig(abstain_nis=nis)),
            localizer=ScanToMapConfig(
                min_tail_nis=1e9, odometry=AdaptiveOdometryConfig(doubt=DoubtConfig(begin_sigmas=1e9))
            ),
        )
        pipeline = Pipeline(config)
        found[nis] = [pipeline.step(scan) for scan in log]
        assert max(errors(truth_from_start(log), pipeline.final().T_map_base)) < 0.03
        pipeline.close()
    careful, bold = found[15.0], found[1e9]
    assert careful[32].innovation_nis > 15.0
    assert not careful[32].is_moving.any()
    assert bold[32].is_moving.any()
    assert all(step.innovation_nis < 15.0 for step in careful[1:32] + careful[33:])
    for step in [*careful[25:32], *careful[33:38]]:
        assert step.is_moving.sum() > 5


def test_where_the_covariance_is_stretched_instead_who_moves_is_found() -> None:
    """The same jump of 0.12 m, contradicted by most of the returns: the pose is in no doubt."""
    log, jump = drive(50), np.array([0.12, 0.0, 0.0])
    log.scans[32:] = [
        replace(scan, T_odom_base=se2.compose(odometry_of(scan), jump)) for scan in log.scans[32:]
    ]
    pipeline = Pipeline(PipelineConfig())
    steps = [pipeline.step(scan) for scan in log]
    assert max(errors(truth_from_start(log), pipeline.final().T_map_base)) < 0.03
    pipeline.close()
    assert steps[32].innovation_nis < 15.0
    for step in steps[30:38]:
        found, person = step.is_moving & step.is_valid, is_person(step.scan) & step.is_valid
        assert (found & person).sum() > 0.5 * person.sum()
        assert (found & ~person).sum() < 5


def test_a_failed_match_calls_nothing_moving() -> None:
    log = drive(50)
    for scan in log.scans[40:42]:
        scan.ranges[:] = np.random.default_rng(scan.index).uniform(0.5, 5.0, LASER.n_beams)
    pipeline = Pipeline(PipelineConfig())
    steps = [pipeline.step(scan) for scan in log]
    pipeline.close()
    for step in steps[40:42]:
        assert step.match is not None
        assert step.match.status == "failed"
        assert not step.is_moving.any()
        assert (step.reason == reasons.UNSUPPORTED).any()


@pytest.mark.parametrize("value", [-0.1, 0.0, float("nan")])
def test_no_return_needs_a_distance(value: float) -> None:
    with pytest.raises(ConfigError, match=f"NoReturnConfig.reach_m must be positive, not {value}"):
        NoReturnConfig(reach_m=value)


def test_every_valid_beam_of_a_crowd_has_a_probability_and_a_reason_that_fits() -> None:
    log = simulate("hall", seed=0, n_people=20)
    for step in islice(Run(log, "graph"), 120):
        assert np.isfinite(step.p_moving[step.is_valid]).all()
        assert (
            np.isin(step.reason, (reasons.FREE, reasons.TRACKED, reasons.VACATED, reasons.ALONG))
            == step.is_moving
        ).all()
