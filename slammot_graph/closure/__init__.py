"""Loop closure on local maps."""

from slammot_graph.closure.closer import Closure, LoopCloser, LoopClosureConfig
from slammot_graph.closure.submap import Submap

__all__ = ["Closure", "LoopCloser", "LoopClosureConfig", "Submap"]
