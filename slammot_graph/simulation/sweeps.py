"""What moves while a laser sweeps: the robot from beam to beam, and the people."""

import numpy as np

from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.simulation.people import PeopleConfig, circles

N_TIMES = 9
"""Times in a sweep at which people are placed."""


def beam_poses(dense: FloatArray, dense_s: float, stamps: FloatArray, beam_times: FloatArray) -> FloatArray:
    """(n, n_beams, 3) poses at the beams of n scans; theta is not wrapped.

    Parameters
    ----------
    dense : (m, 3) array
        Poses of the drive every `dense_s` [s], from the first stamp on; the last one lasts.
    stamps : (n,) array
        Of the first beams [s].
    beam_times : (n_beams,) array
        Since the stamp [s].
    """
    return _interpolated(
        dense, dense_s * np.arange(len(dense), dtype=np.float64), stamps - stamps[0], beam_times
    )


def poses_between(T_world_base: FloatArray, stamps: FloatArray, beam_times: FloatArray) -> FloatArray:
    """(n, n_beams, 3) poses at the beams by those (n, 3) at the stamps (n,); the last one lasts."""
    return _interpolated(T_world_base, stamps, stamps, beam_times)


def _interpolated(
    poses: FloatArray, times: FloatArray, stamps: FloatArray, beam_times: FloatArray
) -> FloatArray:
    at, theta = stamps[:, None] + beam_times, np.unwrap(poses[:, 2])
    return np.stack([np.interp(at, times, column) for column in (poses[:, 0], poses[:, 1], theta)], axis=-1)


def circles_during_sweeps(
    objects: FloatArray, stamps: FloatArray, beam_times: FloatArray, config: PeopleConfig
) -> tuple[FloatArray, IntArray]:
    """Circles (n, t, c, 3) of people at `N_TIMES` times of each sweep, and whose each is (c,); see `people.circles`.

    Parameters
    ----------
    objects : (n, p, 4) array
        x, y, vx, vy at the stamps (n,). Between two they walk straight; who is away at either is so in between.
    """
    last = len(stamps) - 1
    step_s = np.diff(stamps, append=2.0 * stamps[-1] - stamps[-2] if last else stamps[-1] + 1.0)
    after = objects[np.minimum(np.arange(len(stamps)) + 1, last)]
    shapes = []
    for time_s in np.linspace(0.0, float(beam_times[-1]), N_TIMES):
        share = (time_s / step_s)[:, None, None]
        between = objects + share * (after - objects)
        found, person = circles(between, stamps + time_s, config)
        shapes.append(found)
    return np.stack(shapes, axis=1), person
