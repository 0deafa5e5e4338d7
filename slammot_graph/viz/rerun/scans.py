"""The scans of a recording: end points, ellipses and why they move, the robot's place, the local map's anchor."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.viz.rerun.columns import Columns, PointDetails, ellipses_of, packed, times_of
from slammot_graph.viz.rerun.layout import DOUBTFUL, MOVING, STATIC
from slammot_graph.viz.rerun.primitives import Frame, at_height, yaw_quaternion

STATIC_ELLIPSE_EVERY = 10
"""Of the static beams only one in so many shows its ellipse; every moving one does."""


class ScanPanel:
    """What each scan saw, and how far around the robot that usually is."""

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._boxes: list[FloatArray] = []
        self._anchor = -1

    def frame(self) -> Frame:
        """Frame the scans so far in the robot's frame; there must be one."""
        return Frame.around(np.median(self._boxes, axis=0))

    def start(self, step: StepResult) -> None:
        """See the first scan, before any is sent."""
        self._boxes.append(_box(step.scan.points_base()[step.is_valid]))

    def send(self, steps: list[StepResult]) -> None:
        """Send end points, ellipses and the robot's place."""
        import rerun as rr

        times = times_of(steps)
        T_map_base = np.stack([step.T_map_base for step in steps])
        n_valid = np.array([np.count_nonzero(step.is_valid) for step in steps])
        row = np.repeat(np.arange(len(steps)), n_valid)
        points_base = np.concatenate([step.scan.points_base()[step.is_valid] for step in steps])
        points_map = se2.transform(T_map_base[row], points_base[:, None, :])[:, 0]
        is_moving = np.concatenate([step.is_moving[step.is_valid] for step in steps])
        p_moving = np.concatenate([step.p_moving[step.is_valid] for step in steps])
        packed_cov = np.concatenate([step.packed_cov[step.is_valid] for step in steps])
        half_sizes, angle = ellipses_of(packed_cov)
        angle += np.array([step.local_yaw for step in steps])[row]
        why = PointDetails(
            beam=np.concatenate([np.flatnonzero(step.is_valid) for step in steps]),
            p_moving=p_moving,
            reason=np.concatenate([step.reason[step.is_valid] for step in steps]),
            half_sizes=half_sizes,
        )

        self._out.send(
            "/world/robot",
            times,
            rr.Transform3D.columns(
                translation=at_height(T_map_base[:, :2], 0.0),
                quaternion=yaw_quaternion(T_map_base[:, 2]),
            ),
        )
        class_ids = np.where(is_moving, MOVING, np.where(p_moving > 0.5, DOUBTFUL, STATIC))
        points = rr.Points3D.columns(
            positions=at_height(points_base, 0.06), class_ids=class_ids.astype(np.uint16)
        )
        self._out.send(
            "/world/robot/scan", times, [*points.partition(n_valid), *why.columns().partition(n_valid)]
        )
        self._out.n_bytes += 20 * len(row)
        if len(row):
            self._boxes.append(_box(points_base))

        n_rows = len(steps)
        n_moving = np.bincount(row[is_moving], minlength=n_rows)
        moving = rr.Points3D.columns(positions=at_height(points_map[is_moving], 0.04))
        self._out.send_batches("/world/moving/points", times, moving, n_moving)
        is_shown = ~is_moving & (why.beam % STATIC_ELLIPSE_EVERY == 0)
        for name, chosen, z in (("moving", is_moving, 0.05), ("static", is_shown, 0.045)):
            self._out.send_ellipses(
                f"/world/ellipses/{name}",
                times,
                points_map[chosen],
                (half_sizes[chosen], angle[chosen]),
                np.bincount(row[chosen], minlength=n_rows),
                z,
                why[chosen],
            )
        rows_of_nodes = [k for k, step in enumerate(steps) if step.node is not None]
        if rows_of_nodes:
            is_seen = ~is_moving & np.isin(row, rows_of_nodes)
            seen = rr.Points3D.columns(positions=at_height(points_map[is_seen], -0.04))
            lengths = np.bincount(row[is_seen], minlength=n_rows)[rows_of_nodes]
            self._out.send("/world/map/recent", times[rows_of_nodes], seen.partition(lengths))
            self._out.n_bytes += 12 * int(lengths.sum())

        # two numbers a row need no more than this: covariance of the robot's place, in map axes
        pose_cov = se2.body_to_world_covariance(np.stack([step.cov_map for step in steps]), T_map_base[:, 2])
        ellipses = ellipses_of(packed(pose_cov))
        one = np.ones(n_rows, dtype=np.int64)
        self._out.send_ellipses("/world/estimate/cov", times, T_map_base[:, :2], ellipses, one, 0.02)
        self._send_anchors(steps)

    def _send_anchors(self, steps: list[StepResult]) -> None:
        """Send the place of the scan that the local map is attached to, where it changes."""
        import rerun as rr

        anchors = [step.anchor_scan for step in steps]
        before = [self._anchor, *anchors[:-1]]
        self._anchor = anchors[-1]
        changed = [row for row, anchor in enumerate(anchors) if anchor != before[row]]
        if not changed:
            return
        of_steps = [steps[row] for row in changed]
        T_map_anchor = se2.compose(
            np.stack([step.T_map_base for step in of_steps]),
            se2.inverse(np.stack([step.T_anchor_base for step in of_steps])),
        )
        has_anchor = np.array([step.anchor_scan >= 0 for step in of_steps])
        points = rr.Points3D.columns(
            positions=at_height(T_map_anchor[has_anchor, :2], 0.026),
            labels=[f"scan {step.anchor_scan}" for step in of_steps if step.anchor_scan >= 0],
        )
        self._out.send_batches("/world/anchor", times_of(of_steps), points, has_anchor.astype(np.int64))


def _box(points: FloatArray) -> FloatArray:
    """Low and high corner (2, 2) of the robot and most of the points (n, 2) around it [m]."""
    low, high = np.percentile(points, [10.0, 90.0], axis=0) if len(points) else np.zeros((2, 2))
    return np.array([np.minimum(low, -1.0), np.maximum(high, 1.0)])
