"""What the panels of a recording send: columns of many scans at a time, and what they share.

One call per scan and entity would cost more than the step itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slammot_graph.core.results import StepResult
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.viz.rerun.layout import LINE_COLORS, LINE_WIDTHS
from slammot_graph.viz.rerun.primitives import Times, at_height, yaw_quaternion

if TYPE_CHECKING:
    import rerun as rr

SIGMAS_95 = 2.448
"""Semi-axis of a 95% ellipse in the plane, in standard deviations."""


class Columns:
    """Where the panels of a recording send their columns.

    Attributes
    ----------
    rec : rerun.RecordingStream
    n_bytes : int
        About how many bytes of scans were sent, before compression.
    """

    def __init__(self, rec: "rr.RecordingStream") -> None:
        self.rec = rec
        self.n_bytes = 0
        self._last_length: dict[str, int] = {}
        self._named: set[str] = set()

    def send_ellipses(
        self,
        path: str,
        times: Times,
        centres: FloatArray,
        ellipses: tuple[FloatArray, FloatArray],
        lengths: IntArray,
        z: float,
        why: "PointDetails | None" = None,
    ) -> None:
        """Send ellipses: their centres, and semi-axes and angles as of `ellipses_of`, in map axes."""
        import rerun as rr

        half_sizes, angle = ellipses
        columns = rr.Ellipsoids3D.columns(
            centers=at_height(centres, z),
            half_sizes=at_height(half_sizes, 0.002),
            quaternions=yaw_quaternion(angle),
        )
        if why is not None:
            columns = rr.ComponentColumnList([*columns, *why.columns()])
        self.send_batches(path, times, columns, lengths)

    def send_batches(
        self, path: str, times: Times, columns: "rr.ComponentColumnList", lengths: IntArray
    ) -> None:
        """Send batches of changing size; nothing at all while there is nothing to show or to clear."""
        n_instances = int(lengths.sum())
        if n_instances or self._last_length.get(path, 0):
            self.send(path, times, columns.partition(lengths))
        self._last_length[path] = int(lengths[-1])
        self.n_bytes += 40 * n_instances

    def send_scalars(self, name: str, times: Times, values: FloatArray) -> None:
        """Send the finite values of a plot `name`: its group and its line."""
        import rerun as rr

        rows = np.flatnonzero(np.isfinite(values))
        if not len(rows):
            return
        path = f"/plots/{name}"
        if path not in self._named:
            self._named.add(path)
            line = rr.SeriesLines(
                names=name.split("/")[1].replace("_", " "),
                colors=LINE_COLORS.get(name),
                widths=LINE_WIDTHS.get(name, 1.5),
                # the mean of those that share a pixel would hide that one of them was high
                aggregation_policy=rr.components.AggregationPolicy.MinMax,
            )
            self.rec.log(path, line, static=True)
        self.send(path, times[rows], rr.Scalars.columns(scalars=values[rows]))

    def send(self, path: str, times: Times, columns: "Sequence[Any] | rr.ComponentColumnList") -> None:
        """Send columns, a row a time."""
        self.rec.send_columns(path, indexes=times.columns(), columns=columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class PointDetails:
    """What is told of a point that is selected: beam number, probability, reason, semi-axes of the 95% ellipse [m]."""

    beam: IntArray
    p_moving: FloatArray
    reason: IntArray
    half_sizes: FloatArray

    def __getitem__(self, chosen: BoolArray) -> "PointDetails":
        return PointDetails(
            beam=self.beam[chosen],
            p_moving=self.p_moving[chosen],
            reason=self.reason[chosen],
            half_sizes=self.half_sizes[chosen],
        )

    def columns(self) -> "rr.ComponentColumnList":
        """Give them as columns; rerun would turn anything but arrow arrays into lists, number by number."""
        import pyarrow as pa
        import rerun as rr

        from slammot_graph.detection.reasons import REASONS

        semi_mm = np.minimum(np.round(1000.0 * self.half_sizes), 65535).astype(np.uint16)
        reason = pa.DictionaryArray.from_arrays(pa.array(self.reason.astype(np.int8)), pa.array(REASONS))
        return rr.AnyValues.columns(
            beam=pa.array(self.beam.astype(np.uint16)),
            p_moving=pa.array(np.round(self.p_moving, 3).astype(np.float32)),
            reason=reason,
            ellipse_long_mm=pa.array(semi_mm[:, 0]),
            ellipse_short_mm=pa.array(semi_mm[:, 1]),
        )


def times_of(steps: Sequence[StepResult]) -> Times:
    """Give the indices and stamps of steps."""
    index = np.array([step.scan.index for step in steps], dtype=np.int64)
    return Times(index, np.array([step.scan.stamp for step in steps]))


def packed(cov: FloatArray) -> FloatArray:
    """xx, xy, yy (k, 3) of covariances (k, 2, 2) or (k, 3, 3)."""
    return np.column_stack([cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]])


def ellipses_of(packed_cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Semi-axes (k, 2) of the 95% ellipses of covariances xx, xy, yy (k, 3), the longer first; its angle [rad]."""
    a, b, c = packed_cov.T
    mean, spread = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    variances = np.maximum(np.column_stack([mean + spread, mean - spread]), 0.0)
    return SIGMAS_95 * np.sqrt(variances), 0.5 * np.arctan2(2.0 * b, a - c)
