"""Crowds by JuPedSim's collision-free speed model: people who walk between waypoints and around each other."""

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation.free_space import FreeSpace

STEP_S = 0.05
N_WAYPOINTS = 6
RADIUS_M = 0.2


def walk_in_crowd(
    free_space: FreeSpace,
    stamps: FloatArray,
    T_world_base: FloatArray,
    n_people: int,
    speeds_m_s: tuple[float, float],
    keep_off_m: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Simulate a crowd that shares the robot's space.

    Parameters
    ----------
    free_space : FreeSpace
    stamps : (n,) array [s]
    T_world_base : (n, 3) array
        The robot; who would come nearer than `keep_off_m` is moved aside.
    n_people : int
    speeds_m_s : (least, greatest)
        Desired speeds are drawn between these.
    rng : numpy.random.Generator

    Returns
    -------
    (n, n_people, 4) array: x, y [m], vx, vy [m/s], world frame.

    Raises
    ------
    ConfigError
        JuPedSim is not installed, or there is no room for so many.
    """
    try:
        import jupedsim
        import shapely
    except ImportError as error:
        raise ConfigError('crowds need JuPedSim: pip install "slammot-graph[crowds]"') from error
    area = _largest_part(shapely, free_space)
    simulation = jupedsim.Simulation(model=jupedsim.CollisionFreeSpeedModel(), geometry=area, dt=STEP_S)
    spots = _spots(shapely, area, free_space, n_people + N_WAYPOINTS, rng)
    stages = [simulation.add_waypoint_stage(tuple(spot), 0.5) for spot in spots[:N_WAYPOINTS]]
    journey = jupedsim.JourneyDescription(stages)
    for here, there in zip(stages, stages[1:] + stages[:1], strict=True):
        journey.set_transition_for_stage(here, jupedsim.Transition.create_fixed_transition(there))
    journey_id = simulation.add_journey(journey)
    ids = [
        simulation.add_agent(
            jupedsim.CollisionFreeSpeedModelAgentParameters(
                position=tuple(spot),
                desired_speed=float(rng.uniform(*speeds_m_s)),
                radius=RADIUS_M,
                journey_id=journey_id,
                stage_id=int(rng.choice(stages)),
            )
        )
        for spot in spots[N_WAYPOINTS:]
    ]
    positions = np.empty((len(stamps), n_people, 2))
    for k, stamp in enumerate(stamps):
        while simulation.elapsed_time() < stamp - stamps[0]:
            simulation.iterate()
        positions[k] = np.array([simulation.agent(agent).position for agent in ids]).reshape(-1, 2)
    positions = _aside(positions, T_world_base, keep_off_m)
    dt = np.gradient(stamps) if len(stamps) > 1 else np.ones(1)
    velocities = np.gradient(positions, axis=0) / dt[:, None, None] if len(stamps) > 1 else 0.0 * positions
    return np.concatenate([positions, velocities], axis=2)


def _largest_part(shapely, free_space: FreeSpace):  # type: ignore[no-untyped-def]
    """Polygon of the walkable cells, its largest connected part."""
    boxes = []
    for row, line in enumerate(free_space.is_walkable):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]])))
        for first, end in edges.reshape(-1, 2):
            low = free_space.origin + free_space.resolution_m * np.array([first, row])
            high = free_space.origin + free_space.resolution_m * np.array([end, row + 1])
            boxes.append(shapely.box(*low, *high))
    parts = shapely.get_parts(shapely.union_all(boxes))
    return max(parts, key=lambda part: part.area)


def _spots(shapely, area, free_space: FreeSpace, n: int, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    """Places in the area that keep two radii apart from each other and from its edge."""
    inner = area.buffer(-1.5 * RADIUS_M)
    chosen: list[FloatArray] = []
    for point in rng.permutation(free_space.walkable_points):
        if len(chosen) == n:
            return chosen
        apart = all(np.hypot(*(point - other)) > 2.5 * RADIUS_M for other in chosen)
        if apart and inner.contains(shapely.Point(point)):
            chosen.append(point)
    raise ConfigError(f"no room for a crowd of {n - N_WAYPOINTS} people in this world")


def _aside(positions: FloatArray, T_world_base: FloatArray, keep_off_m: float) -> FloatArray:
    offset = positions - T_world_base[:, None, :2]
    distance = np.maximum(np.linalg.norm(offset, axis=2, keepdims=True), 1e-6)
    moved = T_world_base[:, None, :2] + offset / distance * keep_off_m
    return np.asarray(np.where(distance < keep_off_m, moved, positions))
