"""The localizers there are, by their configuration."""

from slammot_graph.localization.base import Localizer
from slammot_graph.localization.config import (
    DeadReckoningConfig,
    ScanToLocalMapConfig,
    ScanToMapConfig,
    ScanToScanConfig,
)
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.localization.scan_to_local_map import ScanToLocalMap
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.localization.scan_to_scan import ScanToScan
from slammot_graph.odometry.adaptive import AdaptiveOdometry
from slammot_graph.odometry.fallback import OdometryOrPreviousMotion
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.odometry.propagation import WheelOdometry

LocalizerConfig = DeadReckoningConfig | ScanToScanConfig | ScanToLocalMapConfig | ScanToMapConfig


def make_localizer(config: LocalizerConfig, noise: OdometryNoise | ConstantNoise) -> Localizer:
    """Build a localizer; `noise` is R_r of its odometry."""
    if isinstance(config, DeadReckoningConfig):
        return DeadReckoning(WheelOdometry(noise))
    if isinstance(config, ScanToScanConfig):
        return ScanToScan(OdometryOrPreviousMotion(noise), config)
    if isinstance(config, ScanToLocalMapConfig):
        return ScanToLocalMap(OdometryOrPreviousMotion(noise), config)
    return ScanToMap(AdaptiveOdometry(noise, config.odometry), config)
