"""What is wrong with a log or a run: statistics gathered scan by scan, and the findings made of them.

`inspect` looks at the scans alone, `odometry` at the raw odometry, `statistics` gathers both with the matches while a
run goes on, `mounting` finds how a laser is turned that nothing tells of, `own_body` the beams that hit the robot
itself, `verdict` puts causes and remedies into words, `checking` does it all for a log without a run folder.
Imports `core`, `logs`, `registration`, `detection`, `localization`, `pipeline_config`, `pipeline` and `methods`.
"""

from slammot_graph.diagnosis.checking import CheckReport, as_mounted, check_log
from slammot_graph.diagnosis.inspect import MatchLimits, ScanStatistics, inspect_first, limits_of
from slammot_graph.diagnosis.statistics import RunStatistics
from slammot_graph.diagnosis.verdict import diagnose, findings_of_map

__all__ = [
    "CheckReport",
    "MatchLimits",
    "RunStatistics",
    "ScanStatistics",
    "as_mounted",
    "check_log",
    "diagnose",
    "findings_of_map",
    "inspect_first",
    "limits_of",
]
