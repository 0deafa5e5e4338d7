"""Simultaneous localization, mapping and moving object tracking with a 2D laser, on a factor graph."""

from slammot_graph.errors import ConfigError, InputError, SlammotError
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
