"""Simulation: worlds, robots, lasers and people with exact truth, and people injected into recorded logs.

May import `core`, `logs` (to write a log) and `mapping` (free space); nothing that runs a method.
Public: the names below.
"""

from slammot_graph.simulation.injection import inject, inject_along
from slammot_graph.simulation.log import SimulatedLog
from slammot_graph.simulation.people import PeopleConfig
from slammot_graph.simulation.scenarios import SCENARIOS, Scenario, simulate

__all__ = ["SCENARIOS", "PeopleConfig", "Scenario", "SimulatedLog", "inject", "inject_along", "simulate"]
