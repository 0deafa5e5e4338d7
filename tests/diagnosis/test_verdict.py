import json
import math
from dataclasses import asdict, replace
from typing import Any, get_args

import pytest

from slammot_graph.core.events import FOUND_AGAIN, make_event
from slammot_graph.core.findings import FindingKind
from slammot_graph.core.odometry_report import Estimated, OdometryReport
from slammot_graph.diagnosis import RunStatistics, diagnose, limits_of
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.health import HealthMonitor
from slammot_graph.methods import get_method
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.run import Run
from tests.rooms import drive, kidnapped, odometry_of


@pytest.fixture(scope="module")
def statistics() -> RunStatistics:
    statistics = RunStatistics(limits_of(get_method("graph").config))
    for step in Run(drive(40)):
        statistics.add(step)
    return statistics


def report(**values: tuple[float, float]) -> OdometryReport:
    made: dict[str, Any] = {name: Estimated(value=value, std=std) for name, (value, std) in values.items()}
    return OdometryReport(**made)


@pytest.mark.parametrize(
    ("values", "kind", "words"),
    [
        (
            {"heading_scale": (-0.98, 0.02)},
            "odometry turns the wrong way",
            "contradicts the laser: it turns the opposite",
        ),
        ({"heading_scale": (0.8, 0.02)}, "heading scale", "divide the wheel base by 0.8"),
        ({"heading_bias_rad_per_m": (-0.1, 0.01)}, "heading bias", "-5.7 +- 0.6 degrees per metre"),
        ({"distance_scale": (0.5, 0.01)}, "distance scale", "distances are 2 times too long"),
        ({"distance_scale": (1.6, 0.01)}, "distance scale", "distances are 1.6 times too short"),
        ({"direction_rad": (3.1, 0.05)}, "mounting turned", "looks turned by 180 degrees"),
        ({"direction_rad": (-3.1, 0.05)}, "mounting turned", "looks turned by 180 degrees"),
        ({"direction_rad": (0.3, 0.02)}, "mounting turned", "a yaw that is +0.300 rad less"),
        (
            {"distance_scale": (0.96, 0.005)},
            "distance scale",
            "or else the laser's ranges 1.04 times too short",
        ),
        (
            {"laser_shift_x_m": (-0.3, 0.01), "laser_shift_y_m": (0.02, 0.01)},
            "mounting shifted",
            "as if it sat 0.30 +- 0.01 m farther back than its pose says",
        ),
        (
            {"laser_shift_x_m": (0.2, 0.01), "laser_shift_y_m": (0.15, 0.02)},
            "mounting shifted",
            "give --laser-pose with x +0.20 m and y +0.15 m more",
        ),
        (
            {"clock_offset_s": (-0.12, 0.01)},
            "clock offset",
            "the laser's lags behind the odometry's by 0.120 +- 0.01 s",
        ),
        ({"noise_scale_m": (6.0, 0.5)}, "odometry noise", "6 times in translation"),
    ],
)
def test_what_the_calibration_found(
    statistics: RunStatistics, values: dict[str, tuple[float, float]], kind: str, words: str
) -> None:
    (finding,) = diagnose(statistics, report(**values))
    assert finding.kind == kind
    assert words in finding.text
    assert finding.remedy
    json.dumps(asdict(finding), allow_nan=False)


@pytest.mark.parametrize(
    "values",
    [
        {},
        {
            "heading_scale": (-1.0, math.inf),
            "distance_scale": (3.0, math.inf),
            "direction_rad": (3.1, math.inf),
        },
        {"heading_scale": (0.8, 0.1), "distance_scale": (1.02, 0.001), "clock_offset_s": (0.01, 0.001)},
        {"laser_shift_x_m": (0.3, 0.11), "laser_shift_y_m": (0.09, 0.001)},
        {"laser_shift_x_m": (0.3, math.inf), "laser_shift_y_m": (math.nan, math.nan)},
        {"direction_rad": (3.1, 1.0), "clock_offset_s": (0.0, 0.1)},
        {"direction_rad": (math.nan, math.nan), "clock_offset_s": (math.nan, math.nan)},
    ],
)
def test_what_is_not_known_or_small_is_not_told(
    statistics: RunStatistics, values: dict[str, tuple[float, float]]
) -> None:
    assert diagnose(statistics, report(**values)) == ()


def test_a_small_difference_of_scale_is_worth_a_word_and_a_large_one_a_warning(
    statistics: RunStatistics,
) -> None:
    severities = [
        finding.severity
        for scale in (1.02, 1.04, 1.06)
        for finding in diagnose(statistics, report(distance_scale=(scale, 0.001)))
    ]
    assert severities == ["info", "warning"]


def test_without_odometry_its_calibration_is_not_told(statistics: RunStatistics) -> None:
    assert (
        diagnose(statistics, OdometryReport(has_odometry=False, clock_offset_s=Estimated(value=1.0, std=0.0)))
        == ()
    )


@pytest.mark.parametrize(
    ("warning", "kind"),
    [
        ("/scan: scans of two frames, laser_front and laser_rear", "frames"),
        ("all stamps are equal; scan numbers serve as time", "stamps"),
        ("stamps wrap at 2^32 ms", "stamps"),
        ("base_link comes by a static transform only, the odometry never moves", "odometry never moves"),
    ],
)
def test_warnings_of_the_log_are_repeated(statistics: RunStatistics, warning: str, kind: str) -> None:
    (finding,) = diagnose(statistics, OdometryReport(), [warning, "something else"])
    assert (finding.kind, finding.severity, finding.text) == (kind, "warning", warning)
    assert kind in get_args(FindingKind)


def test_a_robot_that_was_lost() -> None:
    config = PipelineConfig(localizer=ScanToMapConfig(n_lost=2))
    result = Run(kidnapped(drive(60, with_person=False), 5), config=config).complete()
    kinds = [finding.kind for finding in result.verdict]
    assert "lost" in kinds
    assert "lost" in result.health
    assert result.health.shape == (60,)


def test_a_robot_that_is_not_found_again_is_told() -> None:
    (step,) = Run(drive(1))
    lost = make_event("lost", 0, cause="kidnapped", n_scans=10)
    found = make_event(
        "closure accepted", 0, target_node=1, source_node=2, reason=f"{FOUND_AGAIN}, 3 closures agree"
    )
    for events, text in (([lost], "has not been found again once"), ([lost, found], "found again; the map")):
        statistics = RunStatistics(limits_of(get_method("graph").config))
        statistics.add(replace(step, events=tuple(events)))
        (finding,) = (one for one in diagnose(statistics, OdometryReport(), []) if one.kind == "lost")
        assert text in finding.cause


def test_odometry_that_never_moves() -> None:
    log = drive(60)
    for scan in log.scans:
        odometry_of(scan)[:] = 0.0
    result = Run(log).complete()
    assert "odometry never moves" in [finding.kind for finding in result.verdict]


def test_nothing_could_be_matched_is_the_worst() -> None:
    statistics = RunStatistics(limits_of(get_method("graph").config))
    log = drive(40)
    for step in Run(log):
        statistics.add(step)
    statistics.matches.clear()
    statistics.matches["failed"] = 39
    statistics.health.clear()
    verdict = diagnose(statistics, report(clock_offset_s=(0.5, 0.01)))
    assert [finding.kind for finding in verdict] == ["nothing matched", "clock offset"]
    assert [finding.severity for finding in verdict] == ["error", "warning"]


def test_kiss_icp_tells_of_no_match() -> None:
    assert Run(drive(30), "kiss-icp").complete().verdict == ()


def test_a_contradiction_is_told_with_its_scans() -> None:
    monitor = HealthMonitor()
    statistics = RunStatistics(limits_of(get_method("graph").config))
    for k, step in enumerate(Run(drive(40, with_person=False))):
        match = step.match
        if match is not None and 10 <= k < 20:
            match = replace(match, contradicts_odometry=True)
        health = monitor.update(k, match, is_lost=False)
        statistics.add(replace(step, match=match, health=health.state, events=health.events))
    (finding,) = diagnose(statistics, OdometryReport())
    assert finding.kind == "contradiction"
    assert finding.data == {"n_contradictions": 1, "n_scans": 14}
    assert "contradict each other once, in 14 scans, first at scan 10" in finding.cause
