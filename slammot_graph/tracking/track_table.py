"""All tracks of a tracker as arrays of equal length, an entry for each track."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray


@dataclass(eq=False)
class Tracks:
    """The n tracks, the older ones first.

    Attributes
    ----------
    states, covs : (n, 4), (n, 4, 4) arrays
        x, y, vx, vy [m, m/s].
    starts : (n, 2) array [m]
    ids : (n,) int array
    n_hits : (n,) int array
        Sightings.
    n_alone : (n,) int array
        Sightings with no other track near.
    missed_s : (n,) array [s]
        Since the last sighting.
    empty_s : (n,) array [s]
        Time since then for which the laser saw through the track's place.
    unproven_s : (n,) array [s]
        Time of sightings since the last one that free cells proved.
    twin_s : (n,) array [s]
        For how long it has been on the place of an older track.
    sight : (n,) int array
        What the laser sees there: PRESENT, OCCLUDED, OUT_OF_VIEW or EMPTY of the kernels.
    has_displaced : (n,) bool array
    """

    states: FloatArray
    covs: FloatArray
    starts: FloatArray
    ids: IntArray
    n_hits: IntArray
    n_alone: IntArray
    missed_s: FloatArray
    empty_s: FloatArray
    unproven_s: FloatArray
    twin_s: FloatArray
    sight: IntArray
    has_displaced: BoolArray

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def none(cls) -> "Tracks":
        """Give no tracks."""
        whole, seconds = np.empty(0, dtype=np.int64), np.empty(0)
        return cls(
            states=np.empty((0, 4)),
            covs=np.empty((0, 4, 4)),
            starts=np.empty((0, 2)),
            ids=whole,
            n_hits=whole,
            n_alone=whole,
            missed_s=seconds,
            empty_s=seconds,
            unproven_s=seconds,
            twin_s=seconds,
            sight=whole,
            has_displaced=np.empty(0, dtype=np.bool_),
        )

    def take(self, rows: BoolArray) -> "Tracks":
        """Give some of them."""
        return Tracks(**{name: array[rows] for name, array in vars(self).items()})

    def with_new(self, number: int, place: FloatArray, cov: FloatArray) -> "Tracks":
        """Add one that was first seen at a place (2,), standing, with a covariance (4, 4)."""
        one: dict[str, FloatArray | int] = {
            "states": np.array([place[0], place[1], 0.0, 0.0]),
            "covs": cov,
            "starts": place,
            "ids": number,
            "n_hits": 1,
        }
        n = len(self)
        return Tracks(
            **{
                name: np.concatenate([a, np.empty((1, *a.shape[1:]), a.dtype)])
                for name, a in vars(self).items()
            }
        )._filled(n, one)

    def _filled(self, row: int, values: "dict[str, FloatArray | int]") -> "Tracks":
        for name, array in vars(self).items():
            array[row] = values.get(name, 0)
        return self
