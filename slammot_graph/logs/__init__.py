"""Readers of recorded logs behind one door: `open_log`."""

from slammot_graph.logs.arrays import write_npz_log
from slammot_graph.logs.log import LaserLog, SkippedScan
from slammot_graph.logs.opening import open_log

__all__ = ["LaserLog", "SkippedScan", "open_log", "write_npz_log"]
