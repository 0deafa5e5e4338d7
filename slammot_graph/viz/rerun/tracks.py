"""The moving objects of a recording: tracks with their number, velocity, covariance and trail."""

from itertools import chain

import numpy as np

from slammot_graph.core.results import StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.viz.colors import track_color
from slammot_graph.viz.rerun.columns import Columns, ellipses_of, packed, times_of
from slammot_graph.viz.rerun.primitives import at_height


class TrackPanel:
    """Tracks, and where each of them was a scan before."""

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._last_xy: dict[int, FloatArray] = {}

    def send(self, steps: list[StepResult]) -> None:
        """Send one batch per scan of all tracks, an empty one when there are none."""
        import rerun as rr

        tracks, times = [step.tracks for step in steps], times_of(steps)
        n_tracks = np.array([len(states) for states in tracks], dtype=np.int64)
        states = list(chain.from_iterable(tracks))
        centre = np.array([state.position for state in states]).reshape(-1, 2)
        velocity = np.array([state.velocity for state in states]).reshape(-1, 2)
        cov = np.array([state.position_cov for state in states]).reshape(-1, 2, 2)
        colors = np.array([track_color(state.track_id) for state in states], dtype=np.uint32)
        places = at_height(centre, 0.08)
        before = []
        for of_scan in tracks:
            before += [self._last_xy.get(state.track_id, state.position) for state in of_scan]
            self._last_xy = {state.track_id: state.position for state in of_scan}
        segments = np.stack([np.array(before).reshape(-1, 2), centre], axis=1)

        points = rr.Points3D.columns(positions=places, colors=colors)
        labels = [str(state.track_id) for state in states]
        numbers = rr.Points3D.columns(positions=places, labels=labels)
        arrows = rr.Arrows3D.columns(vectors=at_height(velocity, 0.0), origins=places, colors=colors)
        trail = rr.LineStrips3D.columns(strips=at_height(segments, 0.07), colors=colors)
        self._out.send_batches("/world/tracks/centre", times, points, n_tracks)
        self._out.send_batches("/world/tracks/number", times, numbers, n_tracks)
        self._out.send_batches("/world/tracks/velocity", times, arrows, n_tracks)
        self._out.send_batches("/world/tracks/trail", times, trail, n_tracks)
        self._out.send_ellipses("/world/tracks/cov", times, centre, ellipses_of(packed(cov)), n_tracks, 0.075)
