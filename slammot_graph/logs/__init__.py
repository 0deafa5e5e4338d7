"""Readers of recorded logs behind one door: `open_log`."""

from slammot_graph.logs.log import LaserLog, SkippedScan, open_log

__all__ = ["LaserLog", "SkippedScan", "open_log"]
