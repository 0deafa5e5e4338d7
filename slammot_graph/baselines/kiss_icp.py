"""kiss-icp as a baseline: scans as z = 0 points, with or without odometry as the start value."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import GraphEdge, GridMap, StepResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.detection.base import Detection
from slammot_graph.localization.base import FIRST_COV, FinalEstimate
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.odometry.noise import OdometryNoise


@dataclass(frozen=True, kw_only=True)
class KissIcpConfig:
    """kiss-icp at its best 2D setting, as found by a search.

    Attributes
    ----------
    use_odometry : bool
        Start each registration at the odometry increment, where there is one, in place of the last motion.
    max_range_m, min_range_m : float
    voxel_size_m : float
        Of the map; correspondences reach less than two voxels.
    max_points_per_voxel : int
    fixed_threshold_m : float or None
        None: kiss-icp's adaptive threshold.
    map_spacing_m, match_spacing_m : float or None
        Sub-sampling of the scan for the map and for the match; None: as kiss-icp does it, by half a voxel, and
        of what that leaves by one and a half.
    n_threads : int
        Of its registration; 0: one a core, which sum in an order of chance, so that two runs differ in the last
        digits. The first pipeline of a process sets it for all that follow.
    odometry_noise : OdometryNoise
        Stands in for the covariance, which kiss-icp does not have.
    grid : GridConfig
    """

    use_odometry: bool = False
    max_range_m: float = 20.0
    min_range_m: float = 0.1
    voxel_size_m: float = 0.3
    max_points_per_voxel: int = 40
    fixed_threshold_m: float | None = 0.1
    map_spacing_m: float | None = 0.05
    match_spacing_m: float | None = 0.1
    n_threads: int = 1
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    grid: GridConfig = field(default_factory=GridConfig)

    def __post_init__(self) -> None:
        for name in (
            "max_range_m",
            "min_range_m",
            "voxel_size_m",
            "fixed_threshold_m",
            "map_spacing_m",
            "match_spacing_m",
        ):
            value = getattr(self, name)
            may_be_none = name in ("fixed_threshold_m", "map_spacing_m", "match_spacing_m")
            if not (value is None and may_be_none) and not value > 0.0:
                raise ConfigError(f"{name} must be positive, not {value}")
        if self.max_points_per_voxel < 1:
            raise ConfigError(f"max_points_per_voxel must be at least 1, not {self.max_points_per_voxel}")
        if self.n_threads < 0:
            raise ConfigError(f"n_threads must be 0 or more, not {self.n_threads}")


class KissIcpPipeline:
    """kiss-icp behind the interface of `Pipeline`; it calls nothing moving."""

    def __init__(self, config: KissIcpConfig) -> None:
        self.config = config
        self._icp = _make_kiss_icp(config)
        self.grid = OccupancyGrid(config.grid)
        self._stamp_before = np.nan
        self._T_odom_base: FloatArray | None = None
        self._T_odom_registered: FloatArray | None = None
        self._T_map_base: FloatArray = se2.IDENTITY
        self._cov_map: FloatArray = FIRST_COV
        self._trajectory: list[FloatArray] = []
        self._covariances: list[FloatArray] = []

    def step(self, scan: Scan) -> StepResult:
        """Take in the next scan; "step" in `stage_ms` is kiss-icp's `register_frame` alone."""
        is_valid = scan.is_valid(self.config.max_range_m)
        points = scan.points_base()
        predicted = se2.compose(self._T_map_base, self._increment(scan))
        self._T_odom_base = scan.T_odom_base
        frame = np.column_stack([points[is_valid], np.zeros(np.count_nonzero(is_valid))])
        if self.config.use_odometry and scan.T_odom_base is not None and self._T_odom_registered is not None:
            self._icp.last_delta = _to_matrix(se2.between(self._T_odom_registered, scan.T_odom_base))
        start = time.perf_counter()
        sweep_share = self._sweep_share(scan)
        times = np.zeros(0)
        if scan.beam_times is not None and sweep_share:
            # of the motion since the scan before, up to now
            times = (scan.beam_times[is_valid] - scan.beam_times.max()) / np.ptp(scan.beam_times)
            times = 1.0 + sweep_share * times
        if len(frame):
            self._icp.register_frame(frame, times)
        register_ms = 1e3 * (time.perf_counter() - start)
        before, self._T_map_base = self._T_map_base, predicted
        if len(frame):
            self._T_map_base = _from_matrix(np.asarray(self._icp.last_pose, dtype=np.float64))
            if sweep_share:  # it places the end of a sweep
                delta = _from_matrix(np.asarray(self._icp.last_delta, dtype=np.float64))
                back = se2.exp(-sweep_share * se2.log(delta))
                self._T_map_base = se2.compose(self._T_map_base, back)
            self._T_odom_registered = scan.T_odom_base
        moved = se2.between(before, self._T_map_base)
        cov = self.config.odometry_noise.covariance(moved)
        self._cov_map = se2.compound_covariance(self._cov_map, moved, cov)
        self._trajectory.append(self._T_map_base)
        self._covariances.append(self._cov_map)
        ends = se2.transform(self._T_map_base, np.vstack([scan.laser.origin_base, points]))
        self.grid.update(scan.index, ends[0], ends[1:], is_valid, is_valid)
        detection = Detection.nothing(is_valid)
        return StepResult(
            scan=scan,
            T_map_base=self._T_map_base,
            cov_map=self._cov_map,
            T_map_base_predicted=predicted,
            cov_relative=cov,
            anchor_scan=-1,
            T_anchor_base=se2.IDENTITY,
            cov_anchor_base=cov,
            is_valid=is_valid,
            is_moving=detection.is_moving,
            p_moving=np.where(is_valid, 0.0, np.nan),
            reason=detection.reason,
            packed_cov=detection.packed_cov,
            local_yaw=0.0,
            match=None,
            innovation_nis=float("nan"),
            tracks=(),
            node=None,
            events=(),
            stage_ms={"step": register_ms},
        )

    def _sweep_share(self, scan: Scan) -> float:
        """Duration of the sweep over the time since the scan before; 0 where it is not deskewed."""
        step_s = scan.stamp - self._stamp_before
        self._stamp_before = scan.stamp
        if scan.beam_times is None or not step_s > 0.0:
            return 0.0
        if not self._icp.config.data.deskew:
            self._icp = _deskewing(self._icp)
        return min(float(np.ptp(scan.beam_times)) / step_s, 1.0)

    def _increment(self, scan: Scan) -> FloatArray:
        """(3,) motion since the scan before: by odometry, else the last one of kiss-icp."""
        if scan.T_odom_base is None:
            return _from_matrix(np.asarray(self._icp.last_delta, dtype=np.float64))
        if self._T_odom_registered is None:
            self._T_odom_registered = scan.T_odom_base
        before = scan.T_odom_base if self._T_odom_base is None else self._T_odom_base
        return se2.between(before, scan.T_odom_base)

    def final_labels(self, T_map_base: FloatArray) -> None:
        """See `Pipeline.final_labels`; there are none."""

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """See `Pipeline.nodes_and_edges`; there is no graph."""
        return np.empty((0, 3)), ()

    def odometry_report(self) -> OdometryReport:
        """See `Pipeline.odometry_report`; nothing is estimated."""
        return OdometryReport()

    def final(self) -> FinalEstimate:
        """See `Pipeline.final`."""
        return FinalEstimate(
            T_map_base=np.array(self._trajectory).reshape(-1, 3),
            cov_map=np.array(self._covariances).reshape(-1, 3, 3),
            node_scans=np.empty(0, dtype=np.int64),
            nodes=np.empty((0, 3)),
            edges=(),
        )

    def render_map(self) -> GridMap:
        """See `Pipeline.render_map`."""
        return self.grid.to_map()

    def close(self) -> None:
        """See `Pipeline.close`."""


def _make_kiss_icp(config: KissIcpConfig) -> Any:
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP
    from kiss_icp.voxelization import voxel_down_sample

    kiss = KISSConfig()
    kiss.data.max_range = config.max_range_m
    kiss.data.min_range = config.min_range_m
    kiss.data.deskew = False
    kiss.mapping.voxel_size = config.voxel_size_m
    kiss.mapping.max_points_per_voxel = config.max_points_per_voxel
    kiss.registration.max_num_threads = config.n_threads
    kiss.adaptive_threshold.fixed_threshold = config.fixed_threshold_m
    icp = KissICP(kiss)

    def voxelize(frame: FloatArray) -> tuple[FloatArray, FloatArray]:
        for_map = voxel_down_sample(frame, config.map_spacing_m or 0.5 * config.voxel_size_m)
        if config.match_spacing_m is None:
            return voxel_down_sample(for_map, 1.5 * config.voxel_size_m), for_map
        return voxel_down_sample(frame, config.match_spacing_m), for_map

    icp.voxelize = voxelize
    return icp


def _deskewing(icp: Any) -> Any:
    """Let kiss-icp deskew the scans from now on, as it does where a driver gives the points' times."""
    from kiss_icp.preprocess import get_preprocessor

    icp.config.data.deskew = True
    icp.preprocessor = get_preprocessor(icp.config)
    return icp


def _from_matrix(T_a_b: FloatArray) -> FloatArray:
    return np.array([T_a_b[0, 3], T_a_b[1, 3], np.arctan2(T_a_b[1, 0], T_a_b[0, 0])])


def _to_matrix(T_a_b: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:2, :2] = se2.rotation(T_a_b[2])
    matrix[:2, 3] = T_a_b[:2]
    return matrix
