"""Where the robot is: dead reckoning, the paper's scan-to-scan matching, and ours, scan to map with a pose graph."""

from slammot_graph.localization.base import Estimate, FinalEstimate, Localizer
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.localization.scan_to_map import ScanToMap, ScanToMapConfig
from slammot_graph.localization.scan_to_scan import ScanToScan

__all__ = [
    "DeadReckoning",
    "Estimate",
    "FinalEstimate",
    "Localizer",
    "ScanToMap",
    "ScanToMapConfig",
    "ScanToScan",
]
