import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.diagnosis import checking
from slammot_graph.diagnosis.checking import check_log
from slammot_graph.logs.source import SkippedScan
from tests.rooms import ListLog, drive, odometry_of


def test_a_good_log() -> None:
    report = check_log(drive(40))
    assert report.verdict == ()
    assert (report.scans.n_scans, report.n_matched_scans) == (40, 40)
    assert report.health == {"healthy": 40}
    assert report.raw_odometry.n_with_odometry == 40


def test_without_time_the_rest_is_only_inspected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checking, "MIN_MATCHED", 10)
    shown: list[int] = []
    report = check_log(drive(40), budget_s=0.0, show=shown.append)
    assert (report.scans.n_scans, report.n_matched_scans, shown[-1]) == (40, 10, 40)


def test_a_maximum_range() -> None:
    report = check_log(drive(30), max_range_m=0.5)
    assert [finding.kind for finding in report.verdict] == ["beyond max_range"]


def test_a_log_without_usable_scans() -> None:
    log = ListLog([], skipped=[SkippedScan(place="line 3", reason="no beam")])
    with pytest.raises(InputError, match=r"none of its 1 scans is usable \(line 3: no beam\)"):
        check_log(log)


def test_what_begins_late_is_seen_in_the_whole_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checking, "MIN_MATCHED", 10)
    log = drive(60)
    for scan in log.scans[50:]:
        odometry_of(scan)[:] += np.array([30.0, 0.0, 0.0])
    report = check_log(log, budget_s=0.0)
    assert "odometry jumps" in [finding.kind for finding in report.verdict]
