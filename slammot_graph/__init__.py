"""Simultaneous localization, mapping and moving object tracking with a 2D laser, on a factor graph."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from slammot_graph.core.errors import ConfigError, InputError, SlammotError

if TYPE_CHECKING:
    from slammot_graph.logs import open_log
    from slammot_graph.methods import METHODS, get_method
    from slammot_graph.pipeline import Pipeline, PipelineConfig
    from slammot_graph.run import Run

__version__ = "0.1.0"

__all__ = [
    "METHODS",
    "ConfigError",
    "InputError",
    "Pipeline",
    "PipelineConfig",
    "Run",
    "SlammotError",
    "get_method",
    "open_log",
]

_HOME = {
    "METHODS": "methods",
    "Pipeline": "pipeline",
    "PipelineConfig": "pipeline",
    "Run": "run",
    "get_method": "methods",
    "open_log": "logs",
}
"""Modules that bring in gtsam, numba and scipy: each waits until a name of it is asked for."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
