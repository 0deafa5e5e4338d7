"""Simultaneous localization, mapping and moving object tracking with a 2D laser, on a factor graph.

The public names are those of `__all__`, and the packages `evaluation` and `simulation` with theirs. All other
modules are internal: their names may change with any version.

Log messages go to the logger ``slammot_graph``, which is silent unless the application configures `logging`.
"""

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from slammot_graph.core.errors import ConfigError, InputError, SlammotError

if TYPE_CHECKING:
    from slammot_graph.core.results import RunResult, StepResult
    from slammot_graph.core.saved_map import MapStart, SavedMap
    from slammot_graph.core.saved_run import RunFolder
    from slammot_graph.core.scan import LaserModel, Scan
    from slammot_graph.logs import open_log
    from slammot_graph.methods import METHODS, get_method
    from slammot_graph.pipeline import Pipeline, PipelineConfig
    from slammot_graph.run import Run
    from slammot_graph.saved_maps import closures_between_runs, edit_map, merge_maps
    from slammot_graph.saving import load_run

__version__ = "0.2.0"

__all__ = [
    "METHODS",
    "ConfigError",
    "InputError",
    "LaserModel",
    "MapStart",
    "Pipeline",
    "PipelineConfig",
    "Run",
    "RunFolder",
    "RunResult",
    "SavedMap",
    "Scan",
    "SlammotError",
    "StepResult",
    "closures_between_runs",
    "edit_map",
    "get_method",
    "load_run",
    "merge_maps",
    "open_log",
]

logging.getLogger(__name__).addHandler(logging.NullHandler())

_HOME = {
    "METHODS": "methods.METHODS",
    "LaserModel": "core.scan.LaserModel",
    "MapStart": "core.saved_map.MapStart",
    "Pipeline": "pipeline.Pipeline",
    "PipelineConfig": "pipeline.PipelineConfig",
    "Run": "run.Run",
    "RunFolder": "core.saved_run.RunFolder",
    "RunResult": "core.results.RunResult",
    "SavedMap": "core.saved_map.SavedMap",
    "Scan": "core.scan.Scan",
    "StepResult": "core.results.StepResult",
    "closures_between_runs": "saved_maps.closures_between_runs",
    "edit_map": "saved_maps.edit_map",
    "get_method": "methods.get_method",
    "load_run": "saving.load_run",
    "merge_maps": "saved_maps.merge_maps",
    "open_log": "logs.open_log",
}
"""Names whose modules bring in gtsam, numba and scipy: each is imported on first use."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _HOME[name].rpartition(".")
    value = getattr(import_module(f"{__name__}.{module}"), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
