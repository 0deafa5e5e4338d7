"""What is done with saved maps without a log: merge those of several runs, edit one, and move trajectories along.

`merging` looks for one map in another as a run does that goes on with it; `editing` takes closures out and in.
Imports `core`, `graph`, `loop_closure` and `localization`.
"""

from slammot_graph.saved_maps.editing import edit_map
from slammot_graph.saved_maps.merging import MergedMaps, merge_maps
from slammot_graph.saved_maps.report import RunClosure, closures_between_runs, moved_trajectory

__all__ = [
    "MergedMaps",
    "RunClosure",
    "closures_between_runs",
    "edit_map",
    "merge_maps",
    "moved_trajectory",
]
