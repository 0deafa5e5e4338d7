import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.localization import ScanToMapConfig


def test_the_covariance_of_a_lost_robot() -> None:
    config = ScanToMapConfig(lost_std_m=2.0, lost_std_rad=0.5)
    np.testing.assert_array_equal(config.lost_cov, np.diag([4.0, 4.0, 0.25]))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"n_lost": 0}, "n_lost must be at least 1, not 0"),
        *[
            ({name: 0.0}, f"{name} must be positive, not 0.0")
            for name in ("lost_std_m", "lost_std_rad", "motion_dof")
        ],
        ({"kidnapped_distance_m": -1.0}, "kidnapped_distance_m must not be negative, not -1.0"),
        ({"lost_distance_m": float("nan")}, "lost_distance_m must not be negative, not nan"),
        ({"min_agreement": 1.1}, r"min_agreement must be in \[0, 1\], not 1.1"),
        ({"usual_gain": 0.0}, r"usual_gain must be in \(0, 1\], not 0.0"),
        ({"min_tail_scale": 0.5}, "min_tail_scale must be at least 1, not 0.5"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        ScanToMapConfig(**changes)  # type: ignore[arg-type]
