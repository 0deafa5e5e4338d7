"""What a run keeps of its steps for its result."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event
from slammot_graph.core.results import Health, StepResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization import FinalEstimate


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptScan:
    """What of a step goes into the result; fields as of `StepResult`, of which it is a part."""

    index: int
    stamp: float
    T_map_base: FloatArray
    cov_map: FloatArray
    T_odom_base: FloatArray | None
    T_world_base: FloatArray | None
    is_valid: BoolArray
    is_moving: BoolArray
    p_moving: np.ndarray
    stage_ms: dict[str, float]
    nis: float
    anchor_scan: int
    T_anchor_base: FloatArray
    cov_anchor_base: FloatArray
    health: Health
    laser: int


class KeptScans:
    """What of all steps goes into the result."""

    def __init__(self) -> None:
        self.scans: list[KeptScan] = []
        self.moving_base: list[tuple[int, np.ndarray]] = []
        self.tracks: list[list[float]] = []
        self.is_track_seen: list[bool] = []
        self.n_failed = 0
        self.events: list[Event] = []

    def __len__(self) -> int:
        return len(self.scans)

    def keep(self, step: StepResult) -> None:
        """Keep the next step."""
        if step.is_moving.any():
            points = step.scan.points_base()[step.is_moving]
            self.moving_base.append((len(self.scans), points.astype(np.float32)))
        self.scans.append(
            KeptScan(
                index=step.scan.index,
                stamp=step.scan.stamp,
                T_map_base=step.T_map_base,
                cov_map=step.cov_map,
                T_odom_base=step.scan.T_odom_base,
                T_world_base=None if step.scan.truth is None else step.scan.truth.T_world_base,
                is_valid=step.is_valid,
                is_moving=step.is_moving,
                p_moving=step.p_moving.astype(np.float16),
                stage_ms=dict(step.stage_ms),
                nis=step.innovation_nis,
                anchor_scan=step.anchor_scan,
                T_anchor_base=step.T_anchor_base,
                cov_anchor_base=step.cov_anchor_base,
                health=step.health,
                laser=step.scan.laser.number,
            )
        )
        self.n_failed += step.match is not None and step.match.status == "failed"
        self.events += step.events
        for track in step.tracks:
            (xx, xy), (_, yy) = track.position_cov
            row = [step.scan.stamp, track.track_id, *track.position, *track.velocity, xx, xy, yy]
            self.tracks.append([float(value) for value in (*row, step.scan.index)])
            self.is_track_seen.append(len(track.beams) > 0)

    def online_estimate(self) -> FinalEstimate:
        """Give the poses as they were estimated at the time, without a graph."""
        return FinalEstimate(
            T_map_base=np.array([scan.T_map_base for scan in self.scans]).reshape(-1, 3),
            cov_map=np.array([scan.cov_map for scan in self.scans]).reshape(-1, 3, 3),
            node_scans=np.empty(0, dtype=np.int64),
            nodes=np.empty((0, 3)),
            edges=(),
        )

    def moving_points(self, T_map_base: FloatArray) -> FloatArray:
        """(m, 2) moving points of all scans by the labels of the time, map frame."""
        found = [se2.transform(T_map_base[k], points) for k, points in self.moving_base]
        return np.concatenate([np.empty((0, 2)), *found])
