import pytest

from slammot_graph.localization.config import (
    DeadReckoningConfig,
    ScanToLocalMapConfig,
    ScanToMapConfig,
    ScanToScanConfig,
)
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.localization.factory import LocalizerConfig, make_localizer
from slammot_graph.localization.scan_to_local_map import ScanToLocalMap
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.localization.scan_to_scan import ScanToScan
from slammot_graph.odometry.noise import OdometryNoise


@pytest.mark.parametrize(
    ("config", "kind"),
    [
        (DeadReckoningConfig(), DeadReckoning),
        (ScanToScanConfig(), ScanToScan),
        (ScanToLocalMapConfig(), ScanToLocalMap),
        (ScanToMapConfig(), ScanToMap),
    ],
)
def test_the_factory_builds_what_the_configuration_names(config: LocalizerConfig, kind: type) -> None:
    localizer = make_localizer(config, OdometryNoise())
    assert type(localizer) is kind
    localizer.close()
