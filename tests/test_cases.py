"""Small logs that went wrong once, whole runs with the defaults: the right trajectory, or the cause told, or both."""

import re
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.findings import FindingKind
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.logs import open_log
from slammot_graph.run import Run

pytestmark = pytest.mark.cases


def run(path: Path, max_scans: int | None = None) -> RunResult:
    result = Run(open_log(path), max_scans=max_scans).complete()
    assert not result.failures
    return result


def truth_of(cases: Path, name: str, stamps: FloatArray) -> FloatArray:
    with np.load(cases / name) as file:
        nearest = np.abs(file["stamps"][:, None] - stamps).argmin(axis=0)
        return np.asarray(file["poses"][nearest])


def kinds_of(result: RunResult) -> set[FindingKind]:
    assert all(finding.cause for finding in result.verdict)
    return {finding.kind for finding in result.verdict}


def error_m(result: RunResult, truth: FloatArray) -> float:
    return absolute_error(result.T_map_base, truth).translation_m.rmse


@pytest.mark.parametrize(
    ("name", "within_m", "told"),
    [
        ("wheels_spin.npz", 0.01, {"contradiction"}),
        ("odometry_factor2.npz", 0.01, {"distance scale"}),
        ("contradiction_yaw_sign.npz", 0.01, {"odometry turns the wrong way"}),
        ("odo_turn_sign.npz", 0.03, {"odometry turns the wrong way"}),
        ("odo_jump_2m_forward_building.npz", 0.05, {"odometry jumps"}),
        ("odo_one_1e308.npz", 0.05, set()),
    ],
)
def test_wrong_odometry_leaves_the_trajectory_right_and_is_told(
    cases: Path, name: str, within_m: float, told: set[FindingKind]
) -> None:
    result = run(cases / name)
    assert error_m(result, truth_of(cases, name, result.stamps)) < within_m
    assert told <= kinds_of(result)


@pytest.mark.parametrize("name", ["wheels_spin.npz", "odometry_factor2.npz"])
def test_wrong_odometry_makes_no_walls_walk(cases: Path, name: str) -> None:
    assert len(run(cases / name).tracks) == 0


def test_the_slip_is_told_where_it_is(cases: Path) -> None:
    result = run(cases / "wheels_spin.npz")
    truth = truth_of(cases, "wheels_spin.npz", result.stamps)
    odometry_m = np.linalg.norm(np.diff(result.T_map_odom_base[:, :2], axis=0), axis=1)
    true_m = np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1)
    slips = np.flatnonzero(odometry_m > true_m + 0.02)
    contradicted = np.flatnonzero(result.health == "contradiction")
    assert len(slips) > 20
    assert np.isin(slips, contradicted).mean() > 0.7
    assert result.health[-1] in ("healthy", "recovered")


def test_the_scale_of_the_odometry_is_found(cases: Path) -> None:
    scale = run(cases / "odometry_factor2.npz").odometry.distance_scale
    with np.load(cases / "odometry_factor2.npz") as file:
        true, told = (se2.between(file[name][:-1], file[name][1:])[:, 0] for name in ("poses", "odometry"))
    assert scale.value == pytest.approx((true @ told) / (told @ told), rel=0.02)
    assert scale.std < 0.02


def test_the_sign_of_the_odometry_is_found(cases: Path) -> None:
    scale = run(cases / "contradiction_yaw_sign.npz").odometry.heading_scale
    assert scale.value == pytest.approx(-1.0, abs=0.05)


@pytest.mark.parametrize("name", ["no_encoders", "static_tf_odometry"])
def test_odometry_that_never_moves(cases: Path, name: str) -> None:
    result = run(cases / name)
    assert len(result.stamps) == 393
    with np.load(cases / "odometry_factor2.npz") as file:  # the same drive
        assert error_m(result, file["poses"]) < 0.01
    assert kinds_of(result) & {"odometry never moves", "no odometry"}


def test_a_bag_of_scans_alone(cases: Path) -> None:
    result = run(cases / "laser_only.bag")
    u = 2.0 * np.pi * np.arange(120) / 119.0
    truth = np.column_stack([-1.5 + 0.96 * np.sin(u), -0.6 + 0.5 * (1.0 - np.cos(u)), np.zeros(120)])
    assert error_m(result, truth) < 0.01
    assert not result.odometry.has_odometry
    assert np.isnan(result.T_map_odom_base).all()


def test_a_laser_that_looks_backward_is_mended_and_told(cases: Path) -> None:
    backwards, forwards = (run(cases / f"{name}_laser_no_tf.bag") for name in ("backwards", "forwards"))
    assert error_m(backwards, forwards.T_map_base) < 0.02
    assert any("turned by" in warning for warning in backwards.log.warnings)
    assert "mounting turned" not in kinds_of(forwards)


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("all_max_range.npz", "no returns", "no return"),
        ("millimetres.npz", "ranges in millimetres", "millimetres"),
        ("few_beams.npz", "too few beams", "12 beams"),
        ("two_lasers_one_topic", "frames", "two frames"),
        ("zero_stamps.log", "stamps", "all stamps are the same"),
        ("wrapped_stamps.log", "stamps", r"2\^32"),
    ],
)
def test_the_cause_is_told(cases: Path, name: str, kind: FindingKind, words: str) -> None:
    texts = [finding.text for finding in run(cases / name).verdict if finding.kind == kind]
    assert any(re.search(words, text) for text in texts)


def test_angles_in_degrees_are_told_at_once(cases: Path) -> None:
    result = run(cases / "degrees.npz", max_scans=40)  # each of the others takes a search
    (text,) = [finding.text for finding in result.verdict if finding.kind == "angles in degrees"]
    assert "degrees" in text


@pytest.mark.parametrize(("name", "cause"), [("covered30s_03m", "covers"), ("frozen_laser30s", "same scan")])
def test_a_laser_that_is_blind_for_long(cases: Path, name: str, cause: str) -> None:
    result = run(cases / f"{name}.npz")
    truth = truth_of(cases, f"{name}.npz", result.stamps)
    assert any(cause in event.text for event in result.events if event.kind == "laser blind")
    assert "laser blind" in kinds_of(result)
    for edge in result.edges:
        if edge.kind == "closure":
            a, b = result.node_scans[[edge.from_node, edge.to_node]]
            assert se2.distance(edge.T_from_to, se2.between(truth[a], truth[b]))[0] < 0.2
    from_start = se2.compose(se2.compose(truth[0], se2.inverse(result.T_map_base[0])), result.T_map_base)
    error = np.hypot(*(from_start - truth)[:, :2].T)
    std = np.sqrt(result.cov_map[:, 0, 0] + result.cov_map[:, 1, 1])
    assert std[790] > 0.5  # it grew
    assert (error < 3.5 * std + 0.05).all()


def test_the_forwards_twin_has_nothing_to_tell(cases: Path) -> None:
    assert run(cases / "forwards_laser_no_tf.bag").verdict == ()


def test_what_is_no_log_raises_one_line(cases: Path) -> None:
    with pytest.raises(InputError) as caught:
        open_log(cases / "record_v12.bag")
    assert "\n" not in str(caught.value)


def test_a_leap_of_20_km_while_nothing_is_seen_loses_nothing(cases: Path) -> None:
    result = run(cases / "far_jump_20000m.npz")
    assert len(result.stamps) == 120
    assert np.isfinite(result.T_map_base).all()
    assert max(result.grid.p_occupied.shape) < 2000  # of what was seen, not of the leap
    assert "odometry jumps" in kinds_of(result)


def test_a_slow_laser_that_turns_is_as_good_as_one_that_sees_all_at_once(cases: Path) -> None:
    name, twin = "slow_laser_turns.npz", "slow_laser_turns_snapshot.npz"
    result, of_twin = run(cases / name), run(cases / twin)
    limit_m = 1.5 * error_m(of_twin, truth_of(cases, twin, of_twin.stamps))
    assert error_m(result, truth_of(cases, name, result.stamps)) < limit_m < 0.01
    assert len(result.tracks) == 0
