"""Tracks that go on beyond their labels."""

from collections.abc import Callable

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.tracking.base import ScanView
from slammot_graph.tracking.chain import Chain, SmoothingConfig
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.track_extension import TrackExtension
from tests.tracking.test_segment_tracker import view_of

N, FIRST = 60, 20
STAMPS: FloatArray = np.linspace(0.0, 0.1 * (N - 1), N)
Y = -1.5 + 0.05 * np.arange(N)
X = 2.5


def walk(stays: bool = False) -> Callable[[int], ScanView]:
    """Someone who walks; or who comes out from behind a thing of his size that stays where the labels begin."""

    def scan(k: int) -> ScanView:
        circles = [(X, float(Y[k]), 0.12)]
        if stays:
            circles = [(X, float(Y[FIRST - 1]), 0.12)] + (circles if k >= FIRST else [])
        return view_of(circles, [False] * len(circles))

    return scan


def labelled() -> Chain:
    """The part of it that is labelled."""
    scans = np.arange(FIRST, N - 10)
    return Chain(
        scans=scans,
        places=np.column_stack([np.full(len(scans), X), Y[scans]]),
        covs=np.tile(0.06**2 * np.eye(2), (len(scans), 1, 1)),
        sizes=np.full(len(scans), 0.25),
        thickness=np.full(len(scans), np.nan),
    )


def extended(views: Callable[[int], ScanView]) -> Chain:
    extension = TrackExtension(views, STAMPS, SegmentTrackerConfig().limits())
    chain = labelled()
    return extension.extended(chain, [chain], SmoothingConfig())


def test_a_track_goes_on_where_the_laser_sees_through_at_other_times() -> None:
    found = extended(walk())
    assert found.scans.tolist() == list(range(N))
    error = np.hypot(found.places[:, 0] - X, found.places[:, 1] - Y)
    assert error.max() < 0.12


def test_a_track_does_not_go_on_in_what_stays() -> None:
    assert extended(walk(stays=True)).scans[0] == FIRST


def test_what_jumps_about_is_no_object(rng: np.random.Generator) -> None:
    def chain_of(places: FloatArray) -> Chain:
        n = len(places)
        nothing: BoolArray = np.zeros(n, dtype=np.bool_)
        return Chain(
            scans=np.arange(n), places=places, covs=np.tile(0.01 * np.eye(2), (n, 1, 1)),
            sizes=np.full(n, 0.3), thickness=np.where(nothing, 0.0, np.nan),
        )  # fmt: skip

    config = SmoothingConfig()
    noise = rng.normal(0.0, 1.0, (40, 2))
    way = np.column_stack([np.linspace(0.0, 2.0, 40), np.zeros(40)])
    assert chain_of(way + 0.1 * noise).is_object(config)
    assert chain_of(0.05 * noise).is_object(config)
    assert not chain_of(0.3 * noise).is_object(config)
