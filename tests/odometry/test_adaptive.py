"""Which prediction is used when: a robot whose true poses are known drives past scans that hold nothing."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import Motion, MotionModel, OdometryNoise
from slammot_graph.odometry.adaptive import AdaptiveOdometry, AdaptiveOdometryConfig
from slammot_graph.odometry.calibration_config import CalibrationConfig
from slammot_graph.odometry.motion import MatchedPose

LASER = LaserModel(
    angle_min=0.0, angle_increment=0.1, n_beams=2, range_min=0.1, range_max=9.0, T_base_laser=(0.0, 0.0, 0.0)
)
STD = np.array([0.003, 0.003, 0.0015])
UNCALIBRATED = AdaptiveOdometryConfig(calibration=CalibrationConfig(n_first=10**6))
"""What is told here is not mended."""


def true_steps(n: int, seed: int = 0) -> FloatArray:
    """(n, 3) increments of a robot that drives, turns and stops."""
    rng, at = np.random.default_rng(seed), np.arange(n)
    knots_m, knots_rad = np.arange(0, n + 15, 15), np.arange(0, n + 12, 12)
    speed = np.interp(at, knots_m, rng.uniform(0.0, 0.08, len(knots_m)))
    turn = np.interp(at, knots_rad, rng.uniform(-0.06, 0.06, len(knots_rad)))
    return np.column_stack([speed, np.zeros(n), turn])


@dataclass
class Drive:
    """Steps through a drive and keeps what the model said.

    Attributes
    ----------
    steps : (n, 3) array
        True increments.
    told : (n, 3) array
        The odometry's.
    has_odometry : (n + 1,) bools
    agreement : (n + 1,) array
        Of the matches.
    elsewhere : set of int
        Scans whose matches were found from another start than the prediction.
    """

    steps: FloatArray
    told: FloatArray
    has_odometry: list[bool] = field(default_factory=list)
    agreement: FloatArray = field(default_factory=lambda: np.zeros(0))
    imu: bool = False
    elsewhere: frozenset[int] = frozenset()
    motions: list[Motion | None] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)
    is_contradicted: list[bool] = field(default_factory=list)

    def run(
        self, config: AdaptiveOdometryConfig = UNCALIBRATED, found: FloatArray | None = None
    ) -> AdaptiveOdometry:
        """Drive; `found` (n, 3) are increments of the matches, by default the true ones."""
        rng = np.random.default_rng(1)
        model, n = AdaptiveOdometry(OdometryNoise(), config), len(self.steps)
        has_odometry = self.has_odometry or (n + 1) * [True]
        agreement = self.agreement if len(self.agreement) else np.ones(n + 1)
        T, T_odom, yaw = np.zeros(3), np.array([3.0, -1.0, 0.5]), 0.0
        for k in range(n + 1):
            if k:
                T = se2.compose(T, (self.steps if found is None else found)[k - 1])
                T_odom = se2.compose(T_odom, self.told[k - 1])
                yaw += float(self.steps[k - 1, 2])
            scan = Scan(
                index=k,
                stamp=50.0 + 0.1 * k,
                ranges=np.full(2, np.inf),
                laser=LASER,
                T_odom_base=T_odom if has_odometry[k] else None,
                imu_yaw=yaw if self.imu else None,
            )
            self.motions.append(model.advance(scan))
            self.is_contradicted.append(model.is_contradicted)
            self.sources.append(model.source)
            T_matched = se2.compose(T, rng.normal(0.0, STD))
            match = MatchedPose(
                T_local_base=T_matched,
                cov=np.diag(STD**2),
                cov_independent=np.diag(STD**2),
                agreement=float(agreement[k]),
                is_reliable=True,
                is_elsewhere=k in self.elsewhere,
            )
            model.correct(T_matched, match)
        return model

    def predicted(self) -> FloatArray:
        """(n, 3) increments."""
        return np.array([motion.increment for motion in self.motions if motion is not None])


def test_it_is_a_motion_model() -> None:
    model: MotionModel = AdaptiveOdometry(OdometryNoise(), AdaptiveOdometryConfig())
    assert not model.is_contradicted


def test_good_odometry_is_used_as_it_is() -> None:
    steps = true_steps(100)
    drive = Drive(steps, steps)
    model = drive.run()
    assert drive.motions[0] is None
    np.testing.assert_allclose(drive.predicted(), steps, atol=1e-9)
    for motion in drive.motions[1:]:
        assert motion is not None
        np.testing.assert_allclose(motion.cov, OdometryNoise().covariance(motion.increment))
    report = model.report()
    assert (report.source, report.has_odometry) == ("odometry", True)
    assert (report.n_by_odometry, report.n_by_previous_motion, report.n_contradictions) == (100, 0, 0)
    assert not any(drive.is_contradicted)
    apart = se2.between(model.T_odom_base, path_of(steps))
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)


def path_of(steps: FloatArray) -> FloatArray:
    T = np.zeros(3)
    for step in steps:
        T = se2.compose(T, step)
    return T


def test_odometry_that_goes_on_as_before_is_used_though_a_match_leaps() -> None:
    """Down a corridor nothing would tell of the wrong velocity that such a match leaves behind."""
    steps = true_steps(100)
    found = steps.copy()
    found[60, 0] += 0.4
    drive = Drive(steps, steps)
    model = drive.run(found=found)
    assert not any(drive.is_contradicted)
    np.testing.assert_allclose(drive.predicted(), steps, atol=1e-9)
    assert model.report().n_contradictions == 0


def test_a_match_from_elsewhere_that_leaps_as_no_robot_does_is_not_the_odometrys_fault() -> None:
    """The pose before was wrong, or this one is: neither tells of another motion."""
    steps = true_steps(100)
    found = steps.copy()
    found[59, 0] -= 0.8
    drive = Drive(steps, steps, elsewhere=frozenset({60}))
    model = drive.run(found=found)
    assert set(drive.sources) == {"odometry"}
    assert not any(drive.is_contradicted)
    assert abs(model.previous.velocity.value[0]) < 1.0  # not 8 m/s backward


def test_a_match_from_elsewhere_within_reach_leaves_the_odometry() -> None:
    steps = true_steps(100)
    found = steps.copy()
    found[59, 0] -= 0.1
    drive = Drive(steps, steps, elsewhere=frozenset({60}))
    drive.run(found=found)
    assert drive.is_contradicted[61]


def test_wheels_that_stick_at_once_leave_the_way_unsure() -> None:
    """Their motion is used as told, and is as unsure as it is apart from that before."""
    steps = np.tile([0.05, 0.0, 0.0], (100, 1))
    told = steps.copy()
    told[60:63] = 0.0
    model = AdaptiveOdometry(OdometryNoise(), UNCALIBRATED)
    T_odom = np.zeros(3)
    variances = list[float]()
    for k in range(101):
        T_odom = T_odom if k == 0 else se2.compose(T_odom, told[k - 1])
        motion = model.advance(
            Scan(index=k, stamp=0.1 * k, ranges=np.full(2, np.inf), laser=LASER, T_odom_base=T_odom)
        )
        variances.append(0.0 if motion is None else float(motion.cov[0, 0]))
        T = path_of(steps[:k])
        cov = np.diag((1e-4 if k < 50 else 4.0, 1e-6, 1e-6))  # into a bare corridor
        match = MatchedPose(T, cov, cov, 0.9, is_reliable=False, is_told=False)
        model.correct(T, match)
    assert sum(variances[61:64]) == pytest.approx(0.15**2, rel=0.05)
    assert max(variances[20:61] + variances[64:]) < 1e-3


def test_a_robot_comes_off_the_motion_that_the_odometry_tells_by_what_its_acceleration_allows() -> None:
    steps = true_steps(100)
    drive = Drive(steps, steps, has_odometry=101 * [True])
    assert drive.run().most_change_m == pytest.approx(0.5 * 0.3, abs=0.01)  # 10 m/s^2 in 0.1 s, and 5 cm
    assert Drive(steps, steps, has_odometry=101 * [False]).run().most_change_m == np.inf


@pytest.mark.parametrize("leap", [[2.0, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 1.5], [1e6, 0.0, 0.0]])
def test_a_leap_that_no_robot_can_make_is_not_used(leap: list[float]) -> None:
    steps = true_steps(240)
    told = steps.copy()
    told[60] += leap
    drive = Drive(steps, told)
    model = drive.run()
    contradicted = np.flatnonzero(drive.is_contradicted)
    # it counts as a large error, until better ones have outweighed it
    assert (contradicted[0], contradicted[-1] < 160) == (61, True)
    apart = drive.predicted() - steps
    assert np.abs(apart[60]).max() < 0.1
    np.testing.assert_allclose(np.delete(apart, contradicted - 1, axis=0), 0.0, atol=1e-9)
    assert np.abs(apart[contradicted - 1]).max() < 0.1
    report = model.report()
    assert (report.source, report.n_contradictions) == ("odometry", 1)
    assert report.n_by_previous_motion == len(contradicted)


def dead_from(steps: FloatArray, first: int, last: int = 10**6) -> FloatArray:
    told = steps.copy()
    told[first:last] = 0.0
    return told


def test_wheels_that_die_leave_the_previous_motion() -> None:
    steps = true_steps(200)
    drive = Drive(steps, dead_from(steps, 100))
    model = drive.run()
    left = drive.sources.index("previous motion")
    assert 100 < left < 150
    assert set(drive.sources[left:]) == {"previous motion"}
    assert all(drive.is_contradicted[left:])
    assert not any(drive.is_contradicted[:left])
    apart = np.abs(drive.predicted()[left:] - steps[left:])
    assert np.median(apart[:, 0]) < 0.015
    report = model.report()
    assert report.source == "previous motion"
    assert report.has_odometry


@pytest.mark.parametrize(
    "fault",
    [
        lambda steps: steps * [2.5, 1.0, 1.0],
        lambda steps: steps * [1.0, 1.0, -1.0],
        lambda steps: steps + np.array([0.04, 0.0, 0.0]) * (np.arange(len(steps)) > 50)[:, None],
    ],
)
def test_odometry_that_is_plainly_wrong_is_left(fault: Callable[[FloatArray], FloatArray]) -> None:
    steps = true_steps(200)
    drive = Drive(steps, fault(steps))
    drive.run()
    assert drive.sources[-1] == "previous motion"


def test_odometry_that_is_good_again_is_used_again() -> None:
    steps = true_steps(300)
    drive = Drive(steps, dead_from(steps, 100, 200))
    model = drive.run()
    assert "previous motion" in drive.sources[:200]
    assert drive.sources[-1] == "odometry"
    assert drive.sources[260:] == len(drive.sources[260:]) * ["odometry"]
    assert not any(drive.is_contradicted[260:])
    assert model.report().n_by_previous_motion < 150


def test_odometry_is_used_again_though_steady_motion_predicts_itself_as_well() -> None:
    """Down a corridor at one speed nothing tells both apart, and the matches follow whichever predicts them."""
    steps = np.tile([0.08, 0.0, 0.0], (300, 1))
    drive = Drive(steps, dead_from(steps, 60, 120))
    drive.run()
    assert "previous motion" in drive.sources[60:120]
    assert set(drive.sources[150:]) == {"odometry"}
    undecided = Drive(steps, dead_from(steps, 60, 120))
    undecided.run(replace(UNCALIBRATED, explained_excess=1e-9))
    assert set(undecided.sources[150:180]) == {"previous motion"}


def test_in_company_the_odometry_is_not_left() -> None:
    """Matches that few returns agree with are no judge: the crowd carries them along."""
    steps = true_steps(200)
    carried = steps - np.array([0.05, 0.0, 0.0]) * (np.arange(200) > 50)[:, None]
    judged, doubted = Drive(steps, steps), Drive(steps, steps, agreement=np.full(201, 0.6))
    judged.run(found=carried)
    assert "previous motion" in judged.sources
    doubted.run(found=carried)
    assert set(doubted.sources) == {"odometry"}


def test_the_odometry_comes_back_where_company_begins() -> None:
    steps = true_steps(260)
    agreement = np.where(np.arange(261) < 200, 1.0, 0.4)
    drive = Drive(steps, dead_from(steps, 100), agreement=agreement)
    drive.run()
    assert drive.sources[199] == "previous motion"
    assert drive.sources[-1] == "odometry"


def test_scans_without_odometry_go_on_as_before() -> None:
    steps = true_steps(150)
    drive = Drive(steps, steps, has_odometry=151 * [False])
    model = drive.run()
    apart = np.abs(drive.predicted() - steps)[5:]
    assert apart[:, 0].max() < 0.04
    assert np.median(apart[:, 0]) < 0.01
    assert not any(drive.is_contradicted)
    report = model.report()
    assert (report.source, report.has_odometry) == ("previous motion", False)
    assert (report.n_by_odometry, report.n_by_previous_motion, report.n_contradictions) == (0, 150, 0)
    assert np.isinf(report.distance_scale.std)


def test_a_gap_of_the_odometry_is_bridged_by_the_previous_motion() -> None:
    steps = true_steps(100)
    drive = Drive(steps, steps, has_odometry=[k not in (40, 41) for k in range(101)])
    model = drive.run()
    apart = np.abs(drive.predicted() - steps).max(axis=1)
    assert np.flatnonzero(apart > 1e-9).tolist() == [39, 40, 41]  # the increments to and from what is missing
    assert model.report().n_by_previous_motion == 3
    assert not any(drive.is_contradicted)


@pytest.mark.parametrize("has_odometry", [False, True])
def test_an_imu_tells_the_turn(has_odometry: bool) -> None:
    steps = true_steps(60)
    told = steps * np.array([1.0, 1.0, 0.7])
    drive = Drive(steps, told, imu=True, has_odometry=61 * [has_odometry])
    drive.run()
    np.testing.assert_allclose(drive.predicted()[:, 2], steps[:, 2], atol=1e-9)
    for motion in drive.motions[1:]:
        assert motion is not None
        expected = [0.0, 0.0, UNCALIBRATED.imu_std_rad**2]
        np.testing.assert_allclose(motion.cov[2], expected)
        np.testing.assert_allclose(motion.cov[:, 2], expected)


def test_a_scan_that_was_not_matched_makes_the_previous_motion_less_certain() -> None:
    model = AdaptiveOdometry(OdometryNoise(), UNCALIBRATED)
    scan = Scan(index=0, stamp=0.0, ranges=np.full(2, np.inf), laser=LASER, T_odom_base=None)
    traces = list[float]()
    for k in range(5):
        motion = model.advance(replace(scan, index=k, stamp=0.1 * k))
        if motion is not None:
            traces.append(float(np.trace(motion.cov)))
        model.correct(np.zeros(3), None)
    assert (np.diff(traces) > 0.0).all()


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_what_the_calibration_found_corrects_the_odometry(scale: float) -> None:
    steps = true_steps(400)
    drive = Drive(steps, steps / np.array([scale, 1.0, 1.0]))
    model = drive.run(AdaptiveOdometryConfig())
    assert drive.sources[-1] == "odometry"
    np.testing.assert_allclose(drive.predicted()[-100:], steps[-100:], atol=0.004)
    report = model.report()
    assert report.distance_scale.value == pytest.approx(scale, rel=0.02)
    assert report.distance_scale.std < 0.02 * scale
    assert not any(drive.is_contradicted[-200:])


@pytest.mark.parametrize("name", ["error_gain", "hysteresis", "imu_std_rad", "max_acceleration_m_s2"])
def test_impossible_settings_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"AdaptiveOdometryConfig.{name} must be"):
        AdaptiveOdometryConfig(**{name: 0.0})  # type: ignore[arg-type]
