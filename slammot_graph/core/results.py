"""What a step and a run hand out: plain arrays with their units and frames, nothing that computes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event, EventKind, describe, make_event
from slammot_graph.core.findings import Finding
from slammot_graph.core.log_info import LogInfo
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.scan import Scan
from slammot_graph.core.tracked_object import TrackedObject
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from slammot_graph.core.saved_map import SavedMap

Health = Literal["healthy", "degenerate", "contradiction", "lost", "recovered"]
"""State of the localization at a scan; `localization.health` says when it is which."""

ClosureStatus = Literal["accepted", "waiting", "refused", "outlier"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackState:
    """One moving object at one scan.

    Attributes
    ----------
    track_id : int
    position : (2,) array [m], map frame
    velocity : (2,) array [m/s], map frame
    position_cov : (2, 2) array [m^2], map frame
    beams : (k,) int array
        Beams of this scan that were assigned to the track; empty when it was only predicted.
    """

    track_id: int
    position: FloatArray
    velocity: FloatArray
    position_cov: FloatArray
    beams: IntArray


TRACK_COLUMNS = ("stamp", "id", "x", "y", "vx", "vy", "var_x", "cov_xy", "var_y", "scan_index")
"""Columns of `RunResult.tracks`; the files hold all but the last, and what `run_folder.tracks` adds."""

EdgeKind = Literal["odometry", "match", "closure"]


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class GraphEdge:
    """A factor between two nodes: the pose of `to_node` in the frame of `from_node`."""

    kind: EdgeKind
    from_node: int
    to_node: int
    T_from_to: FloatArray
    information: FloatArray


_CLOSURE_EVENTS: Mapping[ClosureStatus, EventKind] = {
    "accepted": "closure accepted",
    "waiting": "closure waiting",
    "refused": "closure refused",
    "outlier": "closure rejected",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosureAttempt:
    """Two places that might have been one, and what became of it.

    Attributes
    ----------
    target_node, source_node : int
        Graph nodes of the anchors of the earlier and of the later local map.
    status : "accepted", "waiting" (for another to confirm it), "refused" or "outlier"
    reason : str
        Why, in words; empty where there is nothing to add.
    T_target_source : (3,) array
        The relative pose that was found, or where it was refused before that, the one that was expected.
    """

    target_node: int
    source_node: int
    status: ClosureStatus
    reason: str
    T_target_source: FloatArray

    def event(self, scan: int) -> Event:
        """Give what a person should know of it, at the scan of this index."""
        return make_event(_CLOSURE_EVENTS[self.status], scan, **self._data)

    @property
    def text(self) -> str:
        """One line for a person, that of its event."""
        return describe(_CLOSURE_EVENTS[self.status], self._data)

    @property
    def _data(self) -> dict[str, str | int]:
        return {"target_node": self.target_node, "source_node": self.source_node, "reason": self.reason}


@dataclass(kw_only=True, eq=False)
class StepResult:
    """All that one scan brought. Over 12 attributes because it is a record; not frozen, for that is slow to make.

    Attributes
    ----------
    scan : Scan
    T_map_base : (3,) array
        Best pose at this time.
    cov_map : (3, 3) array
        Its covariance in the frame of the map's first pose, right perturbation (body frame): with the error of the map
        itself, also where a saved one is localized in. For what was measured in that map's frame.
    T_map_base_predicted : (3,) array
        The pose before the match.
    cov_relative : (3, 3) array
        The covariance that the moving-point test used: of the predicted base relative to the local map's anchor
        (or what the method puts in its place), body frame.
    anchor_scan : int
        Index of the scan of the local map's anchor when this one was matched; -1 where there is none.
    T_anchor_base : (3,) array
        The matched pose relative to that scan's.
    cov_anchor_base : (3, 3) array
        Its covariance, right perturbation (body frame). Where a saved map is localized in, that of the pose relative to
        the saved keyframes around the robot: for what is done by the map, as to drive through a door that it shows.
    is_valid, is_moving : (n_beams,) bool arrays
    p_moving : (n_beams,) array
        Probability that the beam hit something moving; NaN where not valid.
    reason : (n_beams,) int array
        Why a beam was decided as it was: an index into `motion.REASONS`.
    packed_cov : (n_beams, 3) array
        Covariance of the end points as used by the test [m^2]: xx, xy, yy in the local frame.
    local_yaw : float
        Turn of the local frame in the map [rad].
    match : MatchResult or None
    innovation_nis : float
        Normalised innovation squared of the match against the prediction (3 degrees of freedom); NaN if none.
    tracks : tuple of TrackState
    node : int or None
        Index of the graph node added at this scan.
    events : tuple of Event
        What a person should know.
    closures : tuple of ClosureAttempt
        Loop closures tried at this scan.
    stage_ms : mapping
        Time of each stage [ms]; the whole step under "step".
    health : "healthy", "degenerate", "contradiction", "lost" or "recovered"
    """

    scan: Scan
    T_map_base: FloatArray
    cov_map: FloatArray
    T_map_base_predicted: FloatArray
    cov_relative: FloatArray
    anchor_scan: int
    T_anchor_base: FloatArray
    cov_anchor_base: FloatArray
    is_valid: BoolArray
    is_moving: BoolArray
    p_moving: FloatArray
    reason: IntArray
    packed_cov: FloatArray
    local_yaw: float
    match: MatchResult | None
    innovation_nis: float
    tracks: tuple[TrackState, ...]
    node: int | None
    events: tuple[Event, ...]
    stage_ms: Mapping[str, float]
    closures: tuple[ClosureAttempt, ...] = ()
    health: Health = "healthy"

    @property
    def point_cov_map(self) -> FloatArray:
        """(n_beams, 2, 2) covariance of the end points as used by the test [m^2], map axes."""
        R = se2.rotation(self.local_yaw)
        return R @ self.packed_cov[:, [0, 1, 1, 2]].reshape(-1, 2, 2) @ R.T


FREE_BELOW, OCCUPIED_ABOVE = 0.2, 0.8
"""The paper's thresholds by which a finished map is written and drawn: between them a cell is unknown."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GridMap:
    """An occupancy map: `p_occupied` (rows, cols), row 0 the lowest y, NaN where never seen.

    Attributes
    ----------
    p_occupied : (rows, cols) array
    resolution_m : float
    origin : (2,) array
        Lower left corner of cell [0, 0] in the map frame [m].
    """

    p_occupied: FloatArray
    resolution_m: float
    origin: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RunResult:
    """The outcome of a whole run, all poses optimised; n scans of at most `beams` beams, m nodes.

    Attributes
    ----------
    method : str
    config : mapping
        The method's configuration as nested plain values.
    stamps : (n,) array [s]
    T_map_base : (n, 3) array
        Optimised trajectory, in the log's order.
    T_map_odom_base : (n, 3) array
        Raw odometry, moved so that it starts where the trajectory does; rows of NaN for scans without odometry.
    cov_map : (n, 3, 3) array
        Covariance of `T_map_base` in the frame of the map's first pose, right perturbation: with the map's own error.
    is_valid, is_moving, is_moving_online : (n, beams) bool arrays
        `is_moving` are the final labels; beams that a scan does not have are not valid.
    p_moving : (n, beams) float16 array
    moving_points : (m, 2) array [m]
        All points that move, by the final labels, map frame.
    tracks : (k, 10) array
        The columns `TRACK_COLUMNS` [s, -, m, m, m/s, m/s, m^2, m^2, m^2, -], map frame: linked and smoothed after the
        run where the tracker keeps its sightings, else those of the time.
    is_track_seen : (k,) bool array
        Whether beams of that scan were assigned to the track; else its row was only predicted.
    grid : GridMap
    node_scans : (m,) int array
        Scan index of each graph node.
    nodes : (m, 3) array
        Optimised node poses, map frame.
    edges : tuple of GraphEdge
    stage_ms : mapping of str to (n,) arrays
        "step" is the whole.
    nis : (n,) array
        Normalised innovation squared per scan, NaN where there was no match.
    anchor_scans : (n,) int array
        The scan of the anchor of each scan's local map; -1 where there was none.
    T_anchor_base : (n, 3) array
        Each scan's pose relative to that scan's, as matched at the time.
    cov_anchor_base : (n, 3, 3) array
        Its covariance, right perturbation (body frame); localizing, relative to the saved keyframes around the robot.
    T_world_base : (n, 3) array or None
        True poses, where the log knows them.
    n_failed_matches : int
    n_skipped : int
    events : tuple of Event
        In the order of the scans.
    is_complete : bool
        False when the run was interrupted, or not all of its end could be computed.
    log : LogInfo
        The log that was run.
    failures : tuple of str
        What could not be computed at the end, and why: "map: ..."; in its place is what is known without it.
    health : (n,) array of str
        `StepResult.health` of each scan.
    odometry : OdometryReport
        Calibration of the odometry against the matches.
    verdict : tuple of Finding
        What is wrong with the log or the run, the worst first; empty where nothing is.
    tracks_online : (j, 10) array
        The tracks as reported when each scan came, in the map of that time; identities of their own.
    is_track_online_seen : (j,) bool array
    T_map_base_online : (n, 3) array
        Poses as estimated when each scan came.
    objects : tuple of TrackedObject
        What `tracks` follow, where the run tells.
    laser : (n,) int array or None
        Which of the robot's lasers took each scan, from 0; None: the only one.
    saved_map : SavedMap or None
        What later runs start from: `map.slam` of the run folder; None for a method without a graph.
    is_changed : (n, beams) bool array or None
        Points of what stands where the map that the run started from saw nothing; None where the run started from
        none, or did not find its place there.
    new_points, gone_points : (k, 2) arrays [m]
        Middles of the cells of `grid` that were free in that map and are occupied now, and the other way round.
    """

    method: str
    config: Mapping[str, Any]
    stamps: FloatArray
    T_map_base: FloatArray
    T_map_odom_base: FloatArray
    cov_map: FloatArray
    is_valid: BoolArray
    is_moving: BoolArray
    is_moving_online: BoolArray
    p_moving: Any
    moving_points: FloatArray
    tracks: FloatArray
    is_track_seen: BoolArray
    grid: GridMap
    node_scans: IntArray
    nodes: FloatArray
    edges: tuple[GraphEdge, ...]
    stage_ms: Mapping[str, FloatArray]
    nis: FloatArray
    anchor_scans: IntArray
    T_anchor_base: FloatArray
    cov_anchor_base: FloatArray
    T_world_base: FloatArray | None
    n_failed_matches: int
    n_skipped: int
    events: tuple[Event, ...] = ()
    is_complete: bool = True
    log: LogInfo = field(default_factory=LogInfo)
    failures: tuple[str, ...] = ()
    health: Any = field(default_factory=lambda: np.empty(0, dtype="<U13"))
    odometry: OdometryReport = field(default_factory=OdometryReport)
    verdict: tuple[Finding, ...] = ()
    tracks_online: FloatArray = field(default_factory=lambda: np.empty((0, 10)))
    is_track_online_seen: BoolArray = field(default_factory=lambda: np.empty(0, dtype=np.bool_))
    T_map_base_online: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    objects: tuple[TrackedObject, ...] = ()
    laser: IntArray | None = None
    saved_map: "SavedMap | None" = None
    is_changed: BoolArray | None = None
    new_points: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    gone_points: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    def save(self, directory: str | Path, *, overwrite: bool = False) -> None:
        """Write the run folder, all files but the recording ``run.rrd``; `load_run` reads it back.

        Parameters
        ----------
        directory : str or Path
        overwrite : bool
            Replace a run that is there; other files in the folder stay.

        Raises
        ------
        InputError
            `directory` holds a run and `overwrite` is not set, holds something else, or cannot be written.
        """
        from slammot_graph.saving import save_run  # above this module: a method for the convenience of users

        save_run(self, directory, overwrite=overwrite)
