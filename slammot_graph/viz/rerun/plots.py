"""The plots of a recording: times, counts, NIS, uncertainty and figures of the match."""

from itertools import chain

import numpy as np

from slammot_graph.core.results import StepResult
from slammot_graph.viz.rerun.columns import SIGMAS_95, Columns, ellipses_of, packed, times_of

NIS_BOUND_95 = 7.81
"""95% of a chi-square with 3 degrees of freedom."""


class PlotPanel:
    """A value per scan for each line; keeps nothing between batches."""

    def __init__(self, out: Columns) -> None:
        self._out = out

    def send(self, steps: list[StepResult]) -> None:
        """Send the values of some steps."""
        times = times_of(steps)
        for stage in dict.fromkeys(chain.from_iterable(step.stage_ms for step in steps)):
            took = np.array([step.stage_ms.get(stage, np.nan) for step in steps])
            self._out.send_scalars(f"timing/{stage}", times, took)
        n_valid = np.array([np.count_nonzero(step.is_valid) for step in steps], dtype=np.float64)
        n_moving = np.array([np.count_nonzero(step.is_moving) for step in steps], dtype=np.float64)
        self._out.send_scalars("count/valid", times, n_valid)
        self._out.send_scalars("count/moving", times, n_moving)
        self._out.send_scalars("count/static", times, n_valid - n_moving)
        self._out.send_scalars("tracks/tracks", times, np.array([float(len(step.tracks)) for step in steps]))
        self._out.send_scalars("nis/nis", times, np.array([step.innovation_nis for step in steps]))
        ends = np.full(len(steps), np.nan)
        ends[[0, -1]] = NIS_BOUND_95
        self._out.send_scalars("nis/bound_95", times, ends)
        for name, cov in (
            ("in_map", np.stack([step.cov_map for step in steps])),
            ("relative", np.stack([step.cov_relative for step in steps])),
        ):
            semi_axis = ellipses_of(packed(cov))[0][:, 0] / SIGMAS_95
            self._out.send_scalars(f"std_m/{name}", times, semi_axis)
            heading = np.degrees(np.sqrt(np.maximum(cov[:, 2, 2], 0.0)))
            self._out.send_scalars(f"std_deg/{name}", times, heading)
        for group, name in (("residual", "residual_m"), ("inliers", "inlier_ratio")):
            values = [np.nan if step.match is None else getattr(step.match, name) for step in steps]
            self._out.send_scalars(f"{group}/{name}", times, np.array(values, dtype=np.float64))
