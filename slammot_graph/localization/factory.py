"""The localizers there are, by their configuration."""

from slammot_graph.localization.base import Localizer
from slammot_graph.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig
from slammot_graph.localization.scan_to_map import ScanToMap, ScanToMapConfig
from slammot_graph.localization.scan_to_scan import ScanToScan, ScanToScanConfig
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise

LocalizerConfig = DeadReckoningConfig | ScanToScanConfig | ScanToMapConfig


def make_localizer(config: LocalizerConfig, noise: OdometryNoise | ConstantNoise) -> Localizer:
    """Build a localizer; `noise` is R_r of its odometry."""
    if isinstance(config, DeadReckoningConfig):
        return DeadReckoning(noise)
    if isinstance(config, ScanToScanConfig):
        return ScanToScan(noise, config.point_to_point)
    return ScanToMap(noise, config)
