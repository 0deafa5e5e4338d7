"""Loop closure on local maps."""

from slammot_graph.loop_closure.detector import Closure, LoopCloser, LoopClosureConfig
from slammot_graph.loop_closure.submap import Submap

__all__ = ["Closure", "LoopCloser", "LoopClosureConfig", "Submap"]
