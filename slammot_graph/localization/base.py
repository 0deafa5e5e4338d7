"""What the pipeline asks of a localizer, and what it gets."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event
from slammot_graph.core.linalg import fused
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import ClosureAttempt, GraphEdge, Health
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.scan import Scan
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import BoolArray, FloatArray, IntArray


class Estimate(NamedTuple):
    """A pose in the local frame, which is smooth: no closure makes it jump.

    Attributes
    ----------
    T_local_base : (3,) array
    cov_relative : (3, 3) array
        Relative to the local map's anchor; for localizers without one, to the scan of the cycle before; in a saved map
        that stays as it is, to its keyframes around the robot.
    cov_absolute : (3, 3) array
        In the map, with the error of the map itself. Both are right perturbations (body frame).
    T_anchor_base : (3,) array
        The pose that `cov_relative` is about.
    anchor_scan : int
        Index of the anchor's scan; -1 where there is none.
    """

    T_local_base: FloatArray
    cov_relative: FloatArray
    cov_absolute: FloatArray
    T_anchor_base: FloatArray = se2.IDENTITY
    anchor_scan: int = -1


@dataclass(frozen=True, kw_only=True, eq=False)
class FinalEstimate:
    """The trajectory of n scans and the pose graph of m nodes, as best known now.

    Attributes
    ----------
    T_map_base : (n, 3) array
    cov_map : (n, 3, 3) array
        Right perturbation (body frame).
    node_scans : (m,) int array
        Scan index of each node.
    nodes : (m, 3) array, map frame
    edges : tuple of GraphEdge
    saved_map : SavedMap or None
        What later runs start from, where there is a graph.
    n_spare : int
        The last so many local maps of it show known places: worth keeping only where something has changed.
    earlier : SavedMap or None
        The map that the run started from, as corrected by it; None where not all of the run lies in it.
    """

    T_map_base: FloatArray
    cov_map: FloatArray
    node_scans: IntArray
    nodes: FloatArray
    edges: tuple[GraphEdge, ...]
    saved_map: SavedMap | None = None
    n_spare: int = 0
    earlier: SavedMap | None = None


@dataclass(kw_only=True, eq=False)
class CommitResult:
    """What keeping a scan brought.

    Attributes
    ----------
    node : int or None
        Number of the graph node that was added.
    is_keyframe : bool
        The scan went into the local map.
    is_lost : bool
        The localizer has lost its place at this scan.
    is_place_known : bool
        The prediction goes on nevertheless, and only the local map cannot be used any more; otherwise nothing is known
        of the pose relative to what was remembered before.
    expects_match : bool
        False where the localizer matches once in a while, and this scan lies in between.
    is_mapped : bool
        The scan goes into the map.
    closures : tuple of ClosureAttempt
        Loop closures tried.
    events : tuple of Event
    health : Health or None
        In a saved map that the run started from, in place of what the matches tell: "lost" while the robot's place
        there is not known, "degenerate" where the map does not show what the robot sees.
    """

    node: int | None = None
    is_keyframe: bool = False
    is_lost: bool = False
    is_place_known: bool = False
    expects_match: bool = True
    is_mapped: bool = True
    closures: tuple[ClosureAttempt, ...] = ()
    events: tuple[Event, ...] = ()
    health: Health | None = None


class Localizer(Protocol):
    """Predict, match and commit, in this order, once a scan."""

    @property
    def T_map_local(self) -> FloatArray:
        """(3,) where the local frame lies in the map now."""

    @property
    def spools(self) -> tuple[Spool, ...]:
        """What grows with the scans."""

    def predict(self, scan: Scan) -> Estimate:
        """Carry the last estimate along the motion to the new scan."""

    def deskew(self, scan: Scan) -> Scan:
        """Give the new scan with the motion during its sweep; a scan without beam times comes back as it is."""

    def deskew_again(self, scan: Scan, is_static: BoolArray) -> Scan | None:
        """Give the deskewed scan by what its latest match tells of the motion too; None: it tells nothing new.

        The next match is made with it.
        """

    def join_sweep(self, scan: Scan) -> tuple[Scan, Estimate, MatchResult | None]:
        """Give the deskewed scan, its estimate and its match by what the sweep before tells of where this one began."""

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[Estimate, MatchResult | None]:
        """Match the static points (n, 2) of the new scan; the prediction comes back where that fails.

        May be called again for the same scan and begins anew then. A robust kernel, if there is one, is made
        narrower by `kernel_factor`. `is_valid` are all returns of the scan, those that move included.
        """

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """Keep the scan: in the graph and the local map where it brings something new."""

    def odometry_report(self) -> OdometryReport:
        """Give what the matches so far tell of the odometry."""

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """Give the pose graph as it is now: optimised poses (m, 3) in the map frame, and edges; cheap."""

    def final(self) -> FinalEstimate:
        """Give the whole trajectory, optimised."""

    def close(self) -> None:
        """Release threads."""


def fuse(cov_prior: FloatArray, match: MatchResult) -> FloatArray:
    """(3, 3) covariance of a prediction and a match taken together, as the next prior counts it: cautious."""
    return fused(cov_prior, match.graph_information)


FIRST_COV: FloatArray = 1e-8 * np.eye(3)
FIRST_COV.setflags(write=False)
