"""How motion models tell of the motion during a sweep."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import MotionModel, OdometryNoise
from slammot_graph.odometry.adaptive import AdaptiveOdometry, AdaptiveOdometryConfig
from slammot_graph.odometry.deskew import beam_times_of, knot_times
from slammot_graph.odometry.fallback import OdometryOrPreviousMotion
from slammot_graph.odometry.motion import MatchedPose
from slammot_graph.odometry.propagation import WheelOdometry
from tests.rooms import take_scan

SCAN = take_scan(np.array([2.0, 0.0, 1.5]))
TIMES = 0.1 * np.arange(len(SCAN.ranges)) / len(SCAN.ranges)
VELOCITY = np.array([0.6, 0.0, 1.5])
NOISE = OdometryNoise()


def pose(time_s: float) -> FloatArray:
    """Faster and faster."""
    return se2.exp((time_s + 0.2 * time_s**2) * VELOCITY)


def track() -> OdometryTrack:
    stamps = 0.02 * np.arange(100.0)
    return OdometryTrack.from_samples(100.0 + stamps, np.array([pose(t) for t in stamps]))


def scan(k: int, *, with_odometry: bool = True, with_track: bool = True) -> Scan:
    return replace(
        SCAN,
        index=k,
        stamp=100.0 + 0.1 * k,
        T_odom_base=pose(0.1 * k) if with_odometry else None,
        odometry=track() if with_odometry and with_track else None,
        beam_times=TIMES,
    )


MODELS: Mapping[str, Callable[[], MotionModel]] = {
    "wheels": lambda: WheelOdometry(NOISE),
    "fallback": lambda: OdometryOrPreviousMotion(NOISE),
    "adaptive": lambda: AdaptiveOdometry(NOISE, AdaptiveOdometryConfig()),
}


def drive(model: MotionModel, n: int, **which: bool) -> Scan:
    for k in range(n):
        now = scan(k, **which)
        model.advance(now)
        cov = np.diag([1e-6, 1e-6, 1e-6])
        model.correct(pose(0.1 * k), MatchedPose(pose(0.1 * k), cov, cov, 0.95, is_reliable=True))
    return now


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("n", [1, 6])
def test_the_odometry_after_the_stamp_tells_of_the_sweep(name: str, n: int) -> None:
    model = MODELS[name]()
    now = drive(model, n)
    sweep = model.during_sweep(now)
    start_s = 0.1 * (n - 1)
    for time_s, T in zip(sweep.knot_times, sweep.T_stamp_base, strict=True):
        np.testing.assert_allclose(T, se2.between(pose(start_s), pose(start_s + time_s)), atol=1e-3)
    motion = se2.between(pose(start_s), pose(start_s + TIMES[-1]))
    np.testing.assert_allclose(
        sweep.cov_velocity, NOISE.covariance(motion) / TIMES[-1] ** 2, rtol=0.02, atol=1e-9
    )


@pytest.mark.parametrize("name", MODELS)
def test_of_a_live_source_the_latest_velocity_goes_on(name: str) -> None:
    model = MODELS[name]()
    sweep = model.during_sweep(drive(model, 6, with_track=False))
    np.testing.assert_allclose(sweep.velocity, se2.log(se2.between(pose(0.4), pose(0.5))) / 0.1, atol=0.05)


def test_an_acceleration_after_the_latest_odometry_is_allowed_for() -> None:
    """Nobody knows yet what the robot does after the scan."""
    covs = []
    for with_track in (True, False):
        model = AdaptiveOdometry(NOISE, AdaptiveOdometryConfig())
        covs.append(np.diag(model.during_sweep(drive(model, 6, with_track=with_track)).cov_velocity))
    assert (covs[1] > 1.05 * covs[0]).all()


@pytest.mark.parametrize("name", ["fallback", "adaptive"])
def test_without_odometry_the_velocity_between_the_matches_goes_on(name: str) -> None:
    model = MODELS[name]()
    sweep = model.during_sweep(drive(model, 6, with_odometry=False))
    np.testing.assert_allclose(sweep.velocity, se2.log(se2.between(pose(0.4), pose(0.5))) / 0.1, atol=0.05)
    assert (np.linalg.eigvalsh(sweep.cov_velocity) > 0.0).all()


def test_a_leap_of_the_odometry_bends_no_sweep() -> None:
    model = AdaptiveOdometry(NOISE, AdaptiveOdometryConfig())
    drive(model, 5)
    leaping = track()
    leaping.T_odom_base[leaping.stamps > 100.53, :2] += 3.0
    now = replace(scan(5), odometry=leaping)
    model.advance(now)
    np.testing.assert_allclose(model.during_sweep(now).velocity[:2], VELOCITY[:2] * 1.2, atol=0.3)


def test_only_scans_with_beam_times_sweep() -> None:
    with pytest.raises(ValueError, match="beam times"):
        beam_times_of(SCAN)
    assert knot_times(TIMES)[[0, -1]].tolist() == [0.0, TIMES[-1]]
