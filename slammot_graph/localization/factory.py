"""The localizers there are, by their configuration."""

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.saved_map import MapStart
from slammot_graph.localization.base import Localizer
from slammot_graph.localization.config import (
    DeadReckoningConfig,
    ScanToLocalMapConfig,
    ScanToMapConfig,
    ScanToScanConfig,
)
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.localization.in_saved_map import InSavedMap
from slammot_graph.localization.scan_to_local_map import ScanToLocalMap
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.localization.scan_to_scan import ScanToScan
from slammot_graph.odometry.adaptive import AdaptiveOdometry
from slammot_graph.odometry.fallback import OdometryOrPreviousMotion
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.odometry.propagation import WheelOdometry

LocalizerConfig = DeadReckoningConfig | ScanToScanConfig | ScanToLocalMapConfig | ScanToMapConfig


def make_localizer(
    config: LocalizerConfig, noise: OdometryNoise | ConstantNoise, start: MapStart | None = None
) -> Localizer:
    """Build a localizer; `noise` is R_r of its odometry, `start` a saved map that it starts from.

    Raises
    ------
    ConfigError
        The localizer cannot start from a saved map.
    InputError
        There is no local map in the saved one.
    """
    if start is not None:
        return _starting_from(start, config, noise)
    if isinstance(config, DeadReckoningConfig):
        return DeadReckoning(WheelOdometry(noise))
    if isinstance(config, ScanToScanConfig):
        return ScanToScan(OdometryOrPreviousMotion(noise), config)
    if isinstance(config, ScanToLocalMapConfig):
        return ScanToLocalMap(OdometryOrPreviousMotion(noise), config)
    return ScanToMap(AdaptiveOdometry(noise, config.odometry), config)


def _starting_from(
    start: MapStart, config: LocalizerConfig, noise: OdometryNoise | ConstantNoise
) -> Localizer:
    if not (isinstance(config, ScanToMapConfig) and config.close_loops):
        raise ConfigError("a run starts from a saved map with loop closure only; choose the method graph")
    if not any(component in start.saved.joined for component in start.saved.submap_components):
        raise InputError(
            "the saved map has no local map to find the robot in; run its log with the method graph"
        )
    model = AdaptiveOdometry(noise, config.odometry)
    return InSavedMap(model, config, start) if start.localize else ScanToMap(model, config, start)
