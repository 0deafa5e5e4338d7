"""A ring of corridors, driven round more than once: what loop closure is for."""

from functools import cache

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import SimulatedLog
from tests.driven import driven
from tests.rooms import box

WALLS = np.vstack(
    [
        box(0, 0, 20, 12),
        box(2, 2, 18, 10),
        box(5, 0, 5.8, 0.4),  # cupboards and pillars, no two stretches alike
        box(6.4, 0, 6.6, 0.25),
        box(13, 1.7, 14.1, 2),
        box(19.5, 4, 20, 4.9),
        box(17.9, 7.4, 18.2, 7.8),
        box(15, 11.7, 16.6, 12),
        box(9, 10, 9.4, 10.3),
        box(3, 11.6, 3.5, 12),
        box(0, 7, 0.3, 8.5),
        box(1.8, 4.1, 2, 4.4),
    ]
)
CORNERS = [(3.0, 1.0), (19.0, 1.0), (19.0, 11.0), (1.0, 11.0), (1.0, 1.0)]


@cache
def ring_log(seed: int, *, noise_scale: float = 2.0) -> SimulatedLog:
    """One and a half laps at 5 scans a second; the odometry is worse than the simulator's usual."""
    route = np.array([*CORNERS, *CORNERS[1:3]])
    return driven("ring", WALLS, route, seed, noise_scale=noise_scale)


def true_path(log: SimulatedLog) -> FloatArray:
    """(n, 3) true poses in the frame of the first."""
    return se2.between(log.T_world_base[0], log.T_world_base)


def closure_errors(log: SimulatedLog, result: RunResult) -> FloatArray:
    """(k, 2) error [m], [rad] of each closure in the graph."""
    pairs = [(edge.from_node, edge.to_node) for edge in result.edges if edge.kind == "closure"]
    found = np.array([edge.T_from_to for edge in result.edges if edge.kind == "closure"]).reshape(-1, 3)
    scans = result.node_scans[np.array(pairs, dtype=np.int64).reshape(-1, 2)]
    truth = se2.between(log.T_world_base[scans[:, 0]], log.T_world_base[scans[:, 1]])
    apart = se2.between(truth, found)
    return np.column_stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])])
