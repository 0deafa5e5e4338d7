"""Where the robot is: dead reckoning, the paper's scan-to-scan matching, and ours, scan to map with a pose graph.

`base` holds the protocol; `scan_to_map` puts map matching, lost detection, keyframes and graph insertion in order.
Imports `core`, `odometry`, `mapping`, `registration`, `graph` and `loop_closure`.
"""

from slammot_graph.localization.base import CommitResult, Estimate, FinalEstimate, Localizer
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.localization.scan_to_scan import ScanToScan

__all__ = [
    "CommitResult",
    "DeadReckoning",
    "Estimate",
    "FinalEstimate",
    "Localizer",
    "ScanToMap",
    "ScanToMapConfig",
    "ScanToScan",
]
