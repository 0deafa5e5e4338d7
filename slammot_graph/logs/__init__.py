"""Logs: readers of recorded scans, with odometry or without, a module or more for each format, opened by `open_log`.

May import `core` only.
Public: `open_log`; the other names below are for who adds a format or a live source.
"""

from slammot_graph.core.log_info import LogInfo, SourceInfo
from slammot_graph.logs.arrays import write_npz_log
from slammot_graph.logs.registry import open_log
from slammot_graph.logs.source import LaserLog, SkippedScan, Source, describe, source_of

__all__ = [
    "LaserLog",
    "LogInfo",
    "SkippedScan",
    "Source",
    "SourceInfo",
    "describe",
    "open_log",
    "source_of",
    "write_npz_log",
]
