"""Readers of recorded logs behind one door: `open_log`."""

from slammot_graph.logs.arrays import write_npz_log
from slammot_graph.logs.registry import open_log
from slammot_graph.logs.source import LaserLog, SkippedScan, source_of

__all__ = ["LaserLog", "SkippedScan", "open_log", "source_of", "write_npz_log"]
