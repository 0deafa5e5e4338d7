"""Loop closure on local maps: candidates, verification, a joint decision, and where a lost robot is.

Imports `core`, `mapping`, `registration` and `graph`.
"""

from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.config import ConsistencyConfig, LoopClosureConfig
from slammot_graph.loop_closure.detector import LoopCloser
from slammot_graph.loop_closure.relocalization import RelocalizationConfig
from slammot_graph.loop_closure.submap import Submap, SubmapConfig

__all__ = [
    "Closure",
    "ConsistencyConfig",
    "LoopCloser",
    "LoopClosureConfig",
    "RelocalizationConfig",
    "Submap",
    "SubmapConfig",
]
