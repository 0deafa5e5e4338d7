"""A log that was made, not recorded: it knows the truth."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from slammot_graph.core.scan import LaserModel, Scan, ScanTruth
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.logs import SkippedScan, write_npz_log
from slammot_graph.logs.scan_odometry import rising_track


class SimulatedLog:
    """A `LaserLog` in memory.

    Attributes
    ----------
    path : Path
        Name of the scenario, for messages.
    stamps : (n,) array [s]
    ranges : (n, beams) array [m]
    T_odom_base : (n, 3) array
        Rows of NaN for scans without odometry.
    T_world_base : (n, 3) array
        Truth; of an injected log, the reference trajectory.
    is_moving : (n, beams) bool array
        The beam hit a person, walking or standing.
    object_id : (n, beams) int array
        Which one; -1 for none.
    objects : (n, people, 4) array
        x, y [m], vx, vy [m/s] in the world; NaN while away.
    time_increment_s : float
        Time between beams [s]; 0: all at the stamp.
    lasers : tuple of LaserModel
        Who took the scans in turn; `laser` is the first one.
    """

    def __init__(
        self,
        *,
        name: str,
        laser: LaserModel,
        stamps: FloatArray,
        ranges: FloatArray,
        T_odom_base: FloatArray,
        T_world_base: FloatArray,
        is_moving: BoolArray,
        object_id: IntArray,
        objects: FloatArray,
        time_increment_s: float = 0.0,
        lasers: tuple[LaserModel, ...] = (),
    ) -> None:
        self.path = Path(name)
        self.lasers = lasers or (laser,)
        self.stamps = stamps
        self.ranges = ranges
        self.T_odom_base = T_odom_base
        self.T_world_base = T_world_base
        self.is_moving = is_moving
        self.object_id = object_id
        self.objects = objects
        self.time_increment_s = time_increment_s
        self.skipped: list[SkippedScan] = []
        self.warnings: list[str] = []

    @property
    def n_scans(self) -> int:
        """Scans in the log."""
        return len(self.stamps)

    @property
    def laser(self) -> LaserModel:
        """The first laser."""
        return self.lasers[0]

    def __iter__(self) -> Iterator[Scan]:
        beam_times = None
        if self.time_increment_s:
            beam_times = self.time_increment_s * np.arange(self.laser.n_beams, dtype=np.float64)
        track = rising_track(self.stamps, self.T_odom_base, self.stamps)
        has_odometry = np.atleast_1d(np.isfinite(self.T_odom_base).all(axis=1))
        for k in range(self.n_scans):
            yield Scan(
                index=k,
                stamp=float(self.stamps[k]),
                ranges=self.ranges[k],
                laser=self.lasers[k % len(self.lasers)],
                T_odom_base=self.T_odom_base[k] if has_odometry[k] else None,
                truth=ScanTruth(
                    T_world_base=self.T_world_base[k],
                    is_moving=self.is_moving[k],
                    object_id=self.object_id[k],
                    objects=self.objects[k],
                ),
                odometry=track,
                beam_times=beam_times,
            )

    def with_odometry(self, T_odom_base: FloatArray) -> "SimulatedLog":
        """Give this log with other odometry (n, 3) at its scans, all else shared."""
        return SimulatedLog(
            name=str(self.path),
            laser=self.laser,
            stamps=self.stamps,
            ranges=self.ranges,
            T_odom_base=T_odom_base,
            T_world_base=self.T_world_base,
            is_moving=self.is_moving,
            object_id=self.object_id,
            objects=self.objects,
            time_increment_s=self.time_increment_s,
            lasers=self.lasers,
        )

    def arrays(self) -> dict[str, Any]:
        """Give the keyword arguments of `write_npz_log`."""
        return {
            "stamps": self.stamps,
            "ranges": self.ranges,
            "angle_min": self.laser.angle_min,
            "angle_increment": self.laser.angle_increment,
            "range_min": self.laser.range_min,
            "range_max": self.laser.range_max,
            "odometry": self.T_odom_base if np.isfinite(self.T_odom_base).any() else None,
            **({"time_increment": self.time_increment_s} if self.time_increment_s else {}),
            "laser_pose": np.array(self.laser.T_base_laser),
            "poses": self.T_world_base,
            "is_moving": self.is_moving,
            "object_id": self.object_id,
            "objects": self.objects,
            **self._laser_arrays(),
        }

    def _laser_arrays(self) -> dict[str, Any]:
        """What tells of several lasers; nothing of one."""
        if len(self.lasers) == 1:
            return {}
        return {
            "laser": np.arange(self.n_scans) % len(self.lasers),
            "laser_poses": np.array([laser.T_base_laser for laser in self.lasers]),
        }

    def write(self, path: str | Path) -> None:
        """Write the log with its truth as ``.npz``."""
        write_npz_log(path, **self.arrays())
