"""Readers of recorded logs behind one door: `open_log`."""

from slammot_graph.logs.arrays import write_npz_log
from slammot_graph.logs.log import LaserLog, SkippedScan, source_of
from slammot_graph.logs.opening import open_log

__all__ = ["LaserLog", "SkippedScan", "open_log", "source_of", "write_npz_log"]
