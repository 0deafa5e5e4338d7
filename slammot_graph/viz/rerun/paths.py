"""The paths of a recording: estimate, odometry and truth, a segment per scan, and the error against the truth."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.viz.rerun.columns import Columns, times_of
from slammot_graph.viz.rerun.primitives import at_height


class PathPanel:
    """Where the robot was, by each account."""

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._T_map_frame: dict[str, FloatArray] = {}
        self._last_xy: dict[str, FloatArray] = {}

    def send(self, steps: list[StepResult]) -> None:
        """Send one segment per scan of each path."""
        import rerun as rr

        poses: dict[str, list[FloatArray]] = {"estimate": [step.T_map_base for step in steps]}
        odometry = [step.scan.T_odom_base for step in steps]
        told = [pose for pose in odometry if pose is not None]
        if len(told) == len(steps):
            poses["odom"] = told
        truth = [step.scan.truth.T_world_base for step in steps if step.scan.truth is not None]
        known = [pose for pose in truth if pose is not None]
        if len(known) == len(steps):
            poses["truth"] = known
        times = times_of(steps)
        for z, (name, list_of_poses) in enumerate(poses.items()):
            T = np.stack(list_of_poses)
            # odom and world are moved so that all paths start where the estimate does
            T_map = self._T_map_frame.setdefault(name, se2.compose(steps[0].T_map_base, se2.inverse(T[0])))
            T_map_base = se2.compose(T_map, T)
            if name == "truth":
                self._send_errors(T_map_base, steps)
            xy = T_map_base[:, :2]
            start = self._last_xy.get(name, xy[0])
            segments = np.stack([np.concatenate([start[None], xy[:-1]]), xy], axis=1)
            self._last_xy[name] = xy[-1]
            strips = rr.LineStrips3D.columns(strips=at_height(segments, 0.022 - 0.002 * z))
            self._out.send(f"/world/{name}/path", times, strips)

    def _send_errors(self, T_map_base_true: FloatArray, steps: list[StepResult]) -> None:
        error = se2.between(T_map_base_true, np.stack([step.T_map_base for step in steps]))
        times = times_of(steps)
        self._out.send_scalars("error_m/distance", times, np.hypot(error[:, 0], error[:, 1]))
        self._out.send_scalars("error_deg/turn", times, np.degrees(np.abs(error[:, 2])))
