"""Vehicles after the run: an oriented box that all sightings share, so that the side seen does not pull it near.

The heading is that of the smoothed velocity. Length and width are the extents of what was seen along and across it, at
the sightings that show most. The box is laid against what is seen: by its near end where the laser looks at that, by
both ends where it looks at the side.
"""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.tracking.base import ScanView
from slammot_graph.tracking.chain import Chain, SmoothingConfig

_MIN_SPEED_M_S = 0.2
"""Slower than this the velocity says nothing of the heading, and the last one holds."""

_MIN_HEADINGS = 10
_SHOWS_MOST = 0.95
"""Quantile of the extents: few sightings show a whole side."""


def headings(states: FloatArray) -> FloatArray | None:
    """(n,) headings [rad] of smoothed states (n, 4), those of slow ones from the nearest; None where all are slow."""
    is_fast = np.hypot(states[:, 2], states[:, 3]) >= _MIN_SPEED_M_S
    rows = np.flatnonzero(is_fast)
    if len(rows) < _MIN_HEADINGS:
        return None
    nearest = np.abs(np.arange(len(states))[:, None] - rows[None]).argmin(axis=1)
    angles: FloatArray = np.arctan2(states[:, 3], states[:, 2])[rows[nearest]]
    return angles


def extents(points: FloatArray, place: FloatArray, heading: float) -> tuple[FloatArray, FloatArray]:
    """Least and greatest (2,) of points (k, 2) along and across a heading, from a place."""
    own = (points - place) @ se2.rotation(heading)
    return own.min(axis=0), own.max(axis=0)


def box_centre(low: FloatArray, high: FloatArray, laser: FloatArray, size: FloatArray) -> FloatArray:
    """Centre (2,) of a box of a size (2,), laid against extents (2,), (2,) seen from a laser (2,), all in its axes.

    The end that looks at the laser is seen; both are where the laser is beside the box, and where all of it is seen.
    """
    middle = 0.5 * (low + high)
    half = 0.5 * size
    side = laser - middle
    by_near_end = np.where(side > 0.0, high - half, low + half)
    is_beside = np.abs(side) <= half
    return np.where(is_beside | (high - low >= size), middle, by_near_end)


def laid_in_box(
    chain: Chain, views: list[tuple[FloatArray, ScanView]], stamps: FloatArray, config: SmoothingConfig
) -> tuple[Chain, FloatArray]:
    """The chain with the centres of its box for places, and the box: length and width [m], NaN where it tells none.

    Parameters
    ----------
    chain : Chain
        Of m sightings.
    views : m tuples of (k, 2) array and ScanView
        Points [m] of each sighting, map frame, and its scan.
    stamps : (n,) array [s]
        Of all scans.
    config : SmoothingConfig
    """
    for _ in range(2):
        states, _ = chain.smoothed(chain.scans, stamps, config)
        heading = headings(states)
        if heading is None:
            return chain, np.full(2, np.nan)
        ends = [
            extents(points, place, angle) if len(points) else None
            for (points, _), place, angle in zip(views, chain.places, heading, strict=True)
        ]
        size = np.quantile([high - low for low, high in filter(None, ends)], _SHOWS_MOST, axis=0)
        places = chain.places.copy()
        for m, seen in enumerate(ends):
            if seen is None:
                continue
            R = se2.rotation(heading[m])
            laser = (views[m][1].T_local_laser[:2] - chain.places[m]) @ R
            places[m] += R @ box_centre(*seen, laser, size)
        chain = Chain(**(vars(chain) | {"places": places}))
    return chain, size
