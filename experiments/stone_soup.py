"""Stone Soup's trackers on the clusters that the moving-point test finds: what `experiments.tracking` compares with.

Needs the extra ``trackers``. Constant velocity (q 0.4 m^2/s^3), the clusters' own covariances, a Mahalanobis gate of
3.03, tracks begin after three clusters and end after 1 s without one; JPDA with a detection probability of 0.9 and
0.02 false alarms per m^2.
"""

import datetime
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import TrackState
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.pipeline import Pipeline
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.tracking.base import ScanView
from slammot_graph.tracking.tracker import KalmanTracker, KalmanTrackerConfig

TRACKERS = ("Stone Soup GNN", "Stone Soup JPDA")
_START = datetime.datetime(2026, 1, 1)


def is_installed() -> bool:
    """Whether the package is there."""
    return find_spec("stonesoup") is not None


class RecordingTracker(KalmanTracker):
    """Keeps the clusters of each scan, as a tracker gets them."""

    def __init__(self, config: KalmanTrackerConfig) -> None:
        super().__init__(config)
        self.clusters: dict[float, tuple[FloatArray, FloatArray]] = {}

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: Any = None,
        view: ScanView | None = None,
    ) -> None:
        """Keep the clusters and go on as usual."""
        self.clusters[stamp_s] = centres, centre_covs + self._centre_cov
        super().update(stamp_s, centres, centre_covs, beams, is_proven, view)


def tracks_of(
    log: Iterable[Scan], config: PipelineConfig, name: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stamps (n,) [s], poses at the time (n, 3) and rows of tracks (m, 10) as of `RunResult.tracks_online`."""
    assert isinstance(config.tracker, KalmanTrackerConfig)
    stamps, poses, rows = [], [], []
    follow = _tracker(name)
    with Pipeline(config) as pipeline:
        pipeline.tracker = recorder = RecordingTracker(config.tracker)
        for scan in log:
            step = pipeline.step(scan)
            stamps.append(scan.stamp)
            poses.append(step.T_map_base)
            T = pipeline.localizer.T_map_local
            R = se2.rotation(T[2])
            for state in follow(scan.stamp, *recorder.clusters.pop(scan.stamp, _NONE)):
                cov = R @ state.position_cov @ R.T
                place, velocity = se2.transform(T, state.position[None])[0], R @ state.velocity
                rows.append(
                    [scan.stamp, state.track_id, *place, *velocity, cov[0, 0], cov[0, 1], cov[1, 1], 1.0]
                )
    return np.array(stamps), np.array(poses), np.array(rows).reshape(-1, 10)


_NONE = (np.empty((0, 2)), np.empty((0, 2, 2)))


def _tracker(name: str) -> Any:
    """Give a function of stamp, centres and covariances that returns the tracks then, each a `TrackState`."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.dataassociator.probability import JPDA
    from stonesoup.deleter.time import UpdateTimeDeleter
    from stonesoup.functions import gm_reduce_single
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.update import GaussianStateUpdate
    from stonesoup.updater.kalman import KalmanUpdater

    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.4), ConstantVelocity(0.4)])
    predictor, updater = KalmanPredictor(model), KalmanUpdater(None)
    nearest = GNNWith2DAssignment(
        DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=3.03)
    )
    is_joint = name == "Stone Soup JPDA"
    associator: Any = nearest
    if is_joint:
        associator = JPDA(PDAHypothesiser(predictor, updater, 0.02, prob_detect=0.9, prob_gate=0.99))
    deleter = UpdateTimeDeleter(datetime.timedelta(seconds=1.0))
    initiator = MultiMeasurementInitiator(
        GaussianState([0.0, 0.0, 0.0, 0.0], np.diag([0.0, 1.0, 0.0, 1.0])),
        deleter=deleter, data_associator=nearest, updater=updater, min_points=3,
    )  # fmt: skip
    tracks: set[Any] = set()
    numbers: dict[str, int] = {}

    def joint(hypotheses: Any) -> Any:
        """The mixture of a track's hypotheses as one Gaussian."""
        states, weights = [], []
        for hypothesis in hypotheses:
            states.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
            weights.append(float(hypothesis.probability))
        mean, cov = gm_reduce_single(
            StateVectors([state.state_vector for state in states]),
            np.stack([state.covar for state in states], axis=2),
            np.array(weights),
        )
        return GaussianStateUpdate(mean, cov, hypotheses, states[0].timestamp)

    def follow(stamp_s: float, centres: FloatArray, covs: FloatArray) -> list[TrackState]:
        at = _START + datetime.timedelta(seconds=stamp_s)
        found = {
            Detection(centre, timestamp=at, measurement_model=LinearGaussian(4, (0, 2), cov))
            for centre, cov in zip(centres, covs, strict=True)
        }
        used: set[Any] = set()
        for track, hypotheses in associator.associate(tracks, found, at).items():
            if is_joint:
                seen = [one.measurement for one in hypotheses if one]
                used.update(seen)
                track.append(joint(hypotheses) if seen else hypotheses[0].prediction)
            elif hypotheses:
                used.add(hypotheses.measurement)
                track.append(updater.update(hypotheses))
            else:
                track.append(hypotheses.prediction)
        tracks.difference_update(deleter.delete_tracks(tracks, timestamp=at))
        tracks.update(initiator.initiate(found - used, at))
        return [
            TrackState(
                track_id=numbers.setdefault(track.id, len(numbers)),
                position=np.array(track.state_vector, dtype=np.float64)[[0, 2], 0],
                velocity=np.array(track.state_vector, dtype=np.float64)[[1, 3], 0],
                position_cov=np.array(track.covar, dtype=np.float64)[np.ix_([0, 2], [0, 2])],
                beams=np.empty(0, dtype=np.int64),
            )
            for track in tracks
        ]

    return follow
