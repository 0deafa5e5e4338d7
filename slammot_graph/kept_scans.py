"""What a run keeps of its steps: on the disk once they are many."""

import struct
from array import array
from collections.abc import Iterator, Mapping
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from slammot_graph.core import se2
from slammot_graph.core.events import Event
from slammot_graph.core.results import Health, StepResult
from slammot_graph.core.spool import MOST_IN_MEMORY, Spool
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization import FinalEstimate

HEALTHS: tuple[Health, ...] = get_args(Health)

_ROW = np.dtype(
    [
        ("index", "i8"),
        ("stamp", "f8"),
        ("T_map_base", "f8", 3),
        ("cov_map", "f8", (3, 3)),
        ("T_odom_base", "f8", 3),
        ("T_world_base", "f8", 3),
        ("has_truth", "?"),
        ("health", "u1"),
        ("laser", "i4"),
        ("nis", "f8"),
        ("anchor_scan", "i8"),
        ("T_anchor_base", "f8", 3),
        ("cov_anchor_base", "f8", (3, 3)),
        ("n_beams", "i4"),
        ("n_moving", "i4"),
    ]
)
_TRACK = np.dtype([("values", "f8", 10), ("is_seen", "?")])
_PACKED_TRACK = struct.Struct("=10d?")
_NOWHERE = np.full(3, np.nan)


class KeptScans:
    """What of all steps goes into the result: about 350 bytes a scan, 3 bytes a beam and 81 a track.

    Attributes
    ----------
    n_failed : int
        Matches.
    events : list of Event
    """

    def __init__(self) -> None:
        self.n_failed = 0
        self.events: list[Event] = []
        self._rows = Spool(MOST_IN_MEMORY)
        self._beams = Spool(MOST_IN_MEMORY)
        self._tracks = Spool(MOST_IN_MEMORY)
        self._stage_ms: dict[str, array[float]] = {}
        self._n = 0

    def __len__(self) -> int:
        return self._n

    @property
    def spools(self) -> tuple[Spool, ...]:
        """What grows with the scans."""
        return self._rows, self._beams, self._tracks

    def close(self) -> None:
        """Give the temporary files back."""
        for spool in self.spools:
            spool.close()

    def keep(self, step: StepResult) -> None:
        """Keep the next step."""
        scan, truth = step.scan, step.scan.truth
        T_world_base = None if truth is None else truth.T_world_base
        n_moving = int(np.count_nonzero(step.is_moving))
        row = np.array(
            (
                scan.index,
                scan.stamp,
                step.T_map_base,
                step.cov_map,
                _NOWHERE if scan.T_odom_base is None else scan.T_odom_base,
                _NOWHERE if T_world_base is None else T_world_base,
                T_world_base is not None,
                HEALTHS.index(step.health),
                scan.laser.number,
                step.innovation_nis,
                step.anchor_scan,
                step.T_anchor_base,
                step.cov_anchor_base,
                len(step.is_valid),
                n_moving,
            ),
            dtype=_ROW,
        )
        self._rows.add(row.tobytes())
        beams = [(step.is_valid + 2 * step.is_moving).astype(np.uint8).tobytes()]
        beams.append(step.p_moving.astype(np.float16).tobytes())
        if n_moving:
            beams.append(scan.points_base()[step.is_moving].astype(np.float32).tobytes())
        self._beams.add(b"".join(beams))
        self._keep_times(step.stage_ms)
        self._n += 1
        self.n_failed += step.match is not None and step.match.status == "failed"
        self.events += step.events
        for track in step.tracks:
            (xx, xy), (_, yy) = track.position_cov
            row_of_track = (scan.stamp, track.track_id, *track.position, *track.velocity, xx, xy, yy)
            self._tracks.add(_PACKED_TRACK.pack(*row_of_track, scan.index, len(track.beams) > 0))

    def tracks(self) -> tuple[FloatArray, BoolArray]:
        """Rows (k, 10) of `TRACK_COLUMNS` of the tracks as known at the time, and which (k,) were seen."""
        rows = np.frombuffer(self._tracks.since(0), dtype=_TRACK)
        return rows["values"].copy(), rows["is_seen"].copy()

    def stage_ms(self) -> dict[str, FloatArray]:
        """(n,) times of each stage [ms]; 0 where a scan did not come to it."""
        return {name: np.array(times, dtype=np.float64) for name, times in self._stage_ms.items()}

    def rows(self) -> npt.NDArray[Any]:
        """(n,) structured array of all that is no beam's: fields as of `StepResult`, of which they are a part."""
        rows: npt.NDArray[Any] = np.frombuffer(self._rows.since(0), dtype=_ROW)
        return rows

    def health(self) -> npt.NDArray[np.str_]:
        """(n,) health of each scan."""
        names: npt.NDArray[np.str_] = np.array(HEALTHS, dtype="<U13")[self.rows()["health"]]
        return names

    def beams(self) -> tuple[BoolArray, BoolArray, npt.NDArray[np.float16]]:
        """(n, most) `is_valid`, `is_moving` and `p_moving`: of beams that a scan does not have False and NaN."""
        rows = self.rows()
        shape = (len(rows), int(rows["n_beams"].max(initial=0)))
        is_valid, is_moving = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        p_moving = np.full(shape, np.nan, dtype=np.float16)
        for k, place, n, _ in _places(rows):
            data = self._beams.read(place, 3 * n)
            masks = np.frombuffer(data, dtype=np.uint8, count=n)
            is_valid[k, :n], is_moving[k, :n] = masks & 1, masks & 2
            p_moving[k, :n] = np.frombuffer(data, dtype=np.float16, offset=n)
        return is_valid, is_moving, p_moving

    def online_estimate(self) -> FinalEstimate:
        """Give the poses as they were estimated at the time, without a graph."""
        rows = self.rows()
        return FinalEstimate(
            T_map_base=rows["T_map_base"].copy(),
            cov_map=rows["cov_map"].copy(),
            node_scans=np.empty(0, dtype=np.int64),
            nodes=np.empty((0, 3)),
            edges=(),
        )

    def moving_points(self, T_map_base: FloatArray) -> FloatArray:
        """(m, 2) moving points of all scans by the labels of the time, map frame."""
        found = [np.empty((0, 2))]
        for k, place, n, n_moving in _places(self.rows()):
            if n_moving:
                data = self._beams.read(place + 3 * n, 8 * n_moving)
                points = np.frombuffer(data, dtype=np.float32).astype(np.float64).reshape(-1, 2)
                found.append(se2.transform(T_map_base[k], points))
        return np.concatenate(found)

    def _keep_times(self, stage_ms: Mapping[str, float]) -> None:
        for name in stage_ms:
            if name not in self._stage_ms:
                self._stage_ms[name] = array("f", bytes(4 * self._n))
        for name, times in self._stage_ms.items():
            times.append(stage_ms.get(name, 0.0))


def _places(rows: npt.NDArray[Any]) -> Iterator[tuple[int, int, int, int]]:
    """Number of each scan, where its beams are kept, how many they are and how many of them move."""
    n_beams, n_moving = rows["n_beams"].astype(np.int64), rows["n_moving"].astype(np.int64)
    ends = np.cumsum(3 * n_beams + 8 * n_moving)
    starts = ends - 3 * n_beams - 8 * n_moving
    columns = (starts.tolist(), n_beams.tolist(), n_moving.tolist())
    for k, (place, n, moving) in enumerate(zip(*columns, strict=True)):
        yield k, place, n, moving
