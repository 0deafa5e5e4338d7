"""Kernels of the noise of sightings: what is not the whole body, or more than one, and what a track learns of it."""

import math

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.tracking._kernels import _innovation
from slammot_graph.tracking._segment_kernels import BODY_SEEN

MOST_EXCESS_M = 0.4
"""What is wider than a body by more than this is another kind of object."""


@kernel
def blur_bodies(
    states: FloatArray,
    kinds: IntArray,
    sizes: FloatArray,
    body: float,
    near_variance: float,
    noise: FloatArray,
) -> None:
    """Raise the `noise` (n, 2, 2) of bodies of which what was seen may not be all or may be more than one.

    Of something wider than a `body` [m] it is at either end, half the excess from the middle; with another track nearer
    than two bodies a part may be among that one's: `near_variance` [m^2].
    """
    for t in range(states.shape[0]):
        if kinds[t] != BODY_SEEN:
            continue
        half = 0.5 * min(max(sizes[t] - body, 0.0), MOST_EXCESS_M)
        variance = half * half
        for other in range(states.shape[0]):
            away = math.hypot(states[t, 0] - states[other, 0], states[t, 1] - states[other, 1])
            if other != t and away < 2.0 * body:
                variance += near_variance
                break
        noise[t, 0, 0] += variance
        noise[t, 1, 1] += variance


LEAST_NOISE, MOST_NOISE = (0.25, 1.0), (20.0, 5.0)
"""Bounds of the learnt factors on the variance of a body's and of a leg's sightings: the other leg draws the same way
for many scans, so that innovations tell too little of that error."""


@kernel
def learn_noise(
    states: FloatArray,
    covs: FloatArray,
    centres: FloatArray,
    cluster_of: IntArray,
    kinds: IntArray,
    gain: float,
    noise: FloatArray,
    factors: FloatArray,
) -> None:
    """Scale `noise` (n, 2, 2) by each track's factor of `factors` (kinds, n), and that by its normalised innovation.

    A stochastic approximation of the factor with which the normalised innovation squared averages 2:
    ``factor *= exp(gain * (min(nis, 10) / 2 - 1))``, for tracks with a measurement (-1 in `cluster_of`: none);
    `kinds` (n,) are those of the measurements.
    """
    for t in range(states.shape[0]):
        if cluster_of[t] < 0:
            continue
        kind = kinds[t]
        factor = factors[kind, t]
        noise[t] *= factor
        u, var_u, w, var_w, _ = _innovation(states[t], covs[t], centres[t], noise[t])
        nis = min(u * u / var_u + w * w / var_w, 10.0)
        factor *= math.exp(gain * (0.5 * nis - 1.0))
        factors[kind, t] = min(max(factor, LEAST_NOISE[kind]), MOST_NOISE[kind])
