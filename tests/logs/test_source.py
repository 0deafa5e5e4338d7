"""What is known of a source: a recorded log, or one that is live."""

from collections.abc import Iterator
from pathlib import Path

from slammot_graph.core.scan import Scan
from slammot_graph.logs import LaserLog, LogInfo, SkippedScan, SourceInfo, describe, source_of
from tests.rooms import drive


class Live:
    """Scans as they come, once."""

    def __init__(self, scans: list[Scan]) -> None:
        self.skipped: list[SkippedScan] = []
        self.warnings: list[str] = []
        self._scans = iter(scans)

    def __iter__(self) -> Iterator[Scan]:
        return self._scans


def test_a_recorded_log_is_described() -> None:
    log = drive(3)
    assert isinstance(log, LaserLog)
    log.warnings.append("tf does not tell")
    assert describe(log) == LogInfo(path=Path("list.log"), warnings=("tf does not tell",), n_scans=3)
    assert source_of(log) == {}


def test_the_description_does_not_change_with_the_log() -> None:
    log = drive(3)
    told: SourceInfo = {"scan_topic": "/scan", "laser_pose": (0.1, 0.2, 0.3)}
    log.source = told  # type: ignore[attr-defined]
    info = describe(log)
    told["scan_topic"] = "/other"
    log.warnings.append("later")
    assert info == LogInfo(
        path=Path("list.log"), source={"scan_topic": "/scan", "laser_pose": (0.1, 0.2, 0.3)}, n_scans=3
    )


def test_a_live_source_has_neither_path_nor_length() -> None:
    live = Live(drive(3).scans)
    assert not isinstance(live, LaserLog)
    assert len(list(live)) == 3
    assert not list(live)
    assert describe(live) == LogInfo()
    assert describe(drive(3).scans) == LogInfo()
