"""Simulated worlds, robots, lasers and people; people injected into real logs."""

from slammot_graph.simulation.injection import inject, inject_along
from slammot_graph.simulation.log import SimulatedLog
from slammot_graph.simulation.people import PeopleConfig
from slammot_graph.simulation.scenarios import SCENARIOS, Scenario, simulate

__all__ = ["SCENARIOS", "PeopleConfig", "Scenario", "SimulatedLog", "inject", "inject_along", "simulate"]
