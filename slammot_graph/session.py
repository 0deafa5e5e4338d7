"""One pass of a run over its source: what it consists of, and how its state is kept and taken up again."""

import hashlib
import json
import pickle
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from platform import python_version
from typing import Self

import numpy as np

from slammot_graph.baselines.kiss_icp import KissIcpConfig, KissIcpPipeline
from slammot_graph.conclusion import Outcome
from slammot_graph.core.config import to_plain
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.frozen_state import FrozenRun, freeze, thaw
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.saved_map import MapStart
from slammot_graph.core.scan import Scan
from slammot_graph.core.strict_json import strict_json
from slammot_graph.diagnosis import RunStatistics, limits_of
from slammot_graph.kept_scans import KeptScans
from slammot_graph.methods import Config
from slammot_graph.pipeline import Pipeline

_PACKAGES = ("gtsam", "numpy", "scipy", "numba")
"""Whose version a state is bound to."""


def make_pipeline(config: Config, start: MapStart | None = None) -> Pipeline | KissIcpPipeline:
    """Build what a method's configuration describes, from a saved map on where one is given."""
    if not isinstance(config, KissIcpConfig):
        return Pipeline(config, start)
    if start is not None:
        raise ConfigError("kiss-icp cannot start from a saved map; choose the method graph")
    return KissIcpPipeline(config)


@cache
def _versions() -> str:
    """Versions of all that a state depends on, and a checksum of the package's source."""
    digest = hashlib.sha1(usedforsecurity=False)
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    versions = [f"{name} {metadata.version(name)}" for name in _PACKAGES]
    return ", ".join([f"python {python_version()}", *versions, digest.hexdigest()[:12]])


def fingerprint(method: str, config: Config, start: MapStart | None) -> dict[str, str]:
    """Give what a state is bound to, but for the log."""
    begun = "" if start is None else f"{start.saved.nodes.tobytes()!r} {start.localize} {start.initial_pose}"
    return {
        "method": method,
        "config": json.dumps(strict_json(to_plain(config)), sort_keys=True),
        "start": hashlib.sha1(begun.encode(), usedforsecurity=False).hexdigest()[:12],
        "versions": _versions(),
    }


@dataclass(eq=False)
class Session:
    """One pass over the source.

    Attributes
    ----------
    frozen : FrozenRun or None
        What it is to go on from.
    digest : int
        Checksum of the scans so far.
    track : OdometryTrack or None
        The odometry of the whole log, which all scans refer to.
    """

    pipeline: Pipeline | KissIcpPipeline
    statistics: RunStatistics
    kept: KeptScans = field(default_factory=KeptScans)
    outcome: Outcome | None = None
    is_started: bool = False
    is_observed: bool = False
    is_complete: bool = False
    frozen: FrozenRun | None = None
    digest: int = 0
    track: OdometryTrack | None = None

    @classmethod
    def begin(cls, config: Config, start: MapStart | None) -> Self:
        """Begin at the first scan."""
        return cls(make_pipeline(config, start), RunStatistics(limits_of(config)))

    def see(self, scan: Scan) -> None:
        """Note the next scan, before it is taken."""
        self.track = scan.odometry
        self.digest = _digest(scan, self.digest)
        if self.frozen is not None and len(self.kept) + 1 == self.frozen.n_scans:
            self._check_digest(self.frozen)

    def freeze(self, bound_to: Mapping[str, str]) -> FrozenRun:
        """Give the state after the latest step."""
        pipeline = self.pipeline
        spools = (*self.kept.spools, *self.statistics.spools)
        spools += pipeline.spools if isinstance(pipeline, Pipeline) else ()
        state = None
        if isinstance(pipeline, Pipeline):
            parts = {"pipeline": pipeline, "statistics": self.statistics, "kept": self.kept}
            try:
                state = freeze(parts, spools, self.track)
            except (TypeError, pickle.PicklingError):  # a part of one's own that cannot be kept
                state = None
        return FrozenRun(
            fingerprint=bound_to,
            n_scans=len(self.kept),
            digest=self.digest,
            state=state,
            spools=spools if state is not None else (),
        )

    def thaw(self, scans: Iterator[Scan]) -> None:
        """Go on from the state `frozen`: passes over the scans that it has taken.

        Raises
        ------
        InputError
            These are other scans; the state is damaged.
        """
        frozen = self.frozen
        if frozen is None or frozen.state is None:
            return
        self.frozen = None
        n = 0
        for n, scan in enumerate(scans, start=1):
            self.see(scan)
            if n == frozen.n_scans:
                break
        if n != frozen.n_scans:
            self.digest = -1  # fewer scans
        self._check_digest(frozen)
        parts = thaw(frozen.state, frozen.spools, self.track)
        self.pipeline.close()
        self.pipeline, self.statistics, self.kept = parts["pipeline"], parts["statistics"], parts["kept"]

    def _check_digest(self, frozen: FrozenRun) -> None:
        if self.digest != frozen.digest:
            raise InputError(
                f"the first {frozen.n_scans} scans of the log are not those of the checkpoint; name the log of that"
                " run and its topics as they were, or run with --overwrite to begin anew"
            )


def _digest(scan: Scan, digest: int) -> int:
    """Checksum of the scans so far and this one."""
    digest = zlib.crc32(np.float64(scan.stamp).tobytes(), digest)
    digest = zlib.crc32(scan.ranges.tobytes(), digest)
    return digest if scan.T_odom_base is None else zlib.crc32(scan.T_odom_base.tobytes(), digest)
