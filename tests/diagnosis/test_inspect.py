from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core.scan import Scan
from slammot_graph.diagnosis.inspect import MatchLimits, ScanStatistics, inspect_first, limits_of
from slammot_graph.methods import get_method
from tests.rooms import drive

LIMITS = MatchLimits(min_points=15, max_range_m=40.0)


def statistics_of(scans: list[Scan], limits: MatchLimits = LIMITS) -> ScanStatistics:
    statistics = ScanStatistics(limits)
    for scan in scans:
        statistics.add(scan)
    return statistics


def changed(change: Callable[[Scan], Scan], n: int = 30) -> list[Scan]:
    return [change(scan) for scan in drive(n).scans]


def in_millimetres(scan: Scan) -> Scan:
    laser = replace(scan.laser, range_min=50.0, range_max=30000.0)
    return replace(scan, ranges=1000.0 * scan.ranges, laser=laser)


def in_millimetres_but_the_limits(scan: Scan) -> Scan:
    return replace(scan, ranges=1000.0 * scan.ranges)


def in_degrees(scan: Scan) -> Scan:
    laser = replace(
        scan.laser,
        angle_min=float(np.degrees(scan.laser.angle_min)),
        angle_increment=float(np.degrees(scan.laser.angle_increment)),
    )
    return replace(scan, laser=laser)


def turning_often(scan: Scan) -> Scan:
    return replace(scan, laser=replace(scan.laser, angle_increment=100.0))


def of_few_beams(scan: Scan) -> Scan:
    laser = replace(scan.laser, n_beams=12, angle_increment=15 * scan.laser.angle_increment)
    return replace(scan, ranges=scan.ranges[:180:15], laser=laser)


def at_the_maximum(scan: Scan) -> Scan:
    return replace(scan, ranges=np.full_like(scan.ranges, scan.laser.range_max))


def far_away(scan: Scan) -> Scan:
    return replace(scan, ranges=scan.ranges + 60.0, laser=replace(scan.laser, range_max=130.0))


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (in_millimetres, "ranges in millimetres", "divide ranges, range_min and range_max by 1000"),
        (in_millimetres_but_the_limits, "ranges in millimetres", "ranges look like millimetres"),
        (
            in_degrees,
            "angles in degrees",
            "angles look like degrees: 181 beams cover 43 turns, more than a full turn",
        ),
        (turning_often, "more than a full turn", "mend angle_increment"),
        (of_few_beams, "too few beams", "12 beams, a match needs 15 points"),
        (at_the_maximum, "no returns", "no return in 30 of 30 scans looked at: 100% of the beams"),
        (far_away, "beyond max_range", "every return lies beyond max_range (40 m)"),
    ],
)
def test_what_makes_a_log_useless_is_an_error(change: Callable[[Scan], Scan], kind: str, words: str) -> None:
    (finding,) = statistics_of(changed(change)).findings()
    assert (finding.kind, finding.severity) == (kind, "error")
    assert words in finding.text
    assert "\n" not in finding.text


def test_a_good_log_has_no_findings() -> None:
    statistics = statistics_of(drive(30).scans)
    assert statistics.findings() == []
    assert statistics.has_moved
    assert statistics.rate_hz == pytest.approx(10.0)
    assert statistics.field_of_view_rad == pytest.approx(np.radians(270.0))
    assert statistics.n_lasers == 1


def test_a_laser_that_is_covered_for_a_while_is_a_warning() -> None:
    scans = drive(40).scans
    for scan in scans[10:25]:
        scan.ranges[:] = np.inf
    (finding,) = statistics_of(scans).findings()
    assert (finding.kind, finding.severity) == ("too few returns", "warning")
    assert "15 of 40 scans" in finding.cause


def test_dead_reckoning_asks_for_no_returns() -> None:
    limits = limits_of(get_method("odometry").config)
    assert not limits.makes_matches
    assert statistics_of(changed(at_the_maximum), limits).findings() == []


@pytest.mark.parametrize("method", ["graph", "icp", "kiss-icp"])
def test_limits_are_those_of_the_method(method: str) -> None:
    config = get_method(method).config
    limits = limits_of(config)
    assert limits.makes_matches
    assert limits.max_range_m == config.max_range_m


def test_a_laser_that_stands_has_not_moved_whoever_walks_by() -> None:
    scan = drive(1).scans[0]
    rng = np.random.default_rng(0)
    scans = []
    for k in range(60):
        ranges = scan.ranges + rng.normal(0.0, 0.01, len(scan.ranges))
        ranges[k : k + 30] = 1.0
        scans.append(replace(scan, index=k, stamp=0.1 * k, ranges=ranges))
    assert not statistics_of(scans).has_moved


def test_only_the_first_scans_are_read() -> None:
    log = drive(30)
    for scan in log.scans[5:]:
        scan.ranges[:] = 30.0
    assert inspect_first(log, LIMITS, n_scans=5) == []
    assert [finding.kind for finding in inspect_first(log.scans[5:], LIMITS)] == ["no returns"]
    assert inspect_first([], LIMITS) == []
