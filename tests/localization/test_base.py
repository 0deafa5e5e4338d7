import numpy as np

from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.base import FIRST_COV, fuse
from tests.localization.matches import match_with


def match_of(information: FloatArray) -> MatchResult:
    return match_with(information=information, graph_information=information)


def test_fusing_adds_information() -> None:
    cov = np.diag([0.2, 0.1, 0.05]) ** 2
    np.testing.assert_allclose(fuse(cov, match_of(np.linalg.inv(cov))), cov / 2, rtol=1e-9)
    np.testing.assert_allclose(fuse(cov, match_of(np.zeros((3, 3)))), cov, rtol=1e-9)
    weak = fuse(cov, match_of(np.diag([0.0, 1e6, 1e6])))
    np.testing.assert_allclose(np.diag(weak), [0.04, 1 / (1e6 + 100), 1 / (1e6 + 400)], rtol=1e-6)


def test_the_first_covariance_cannot_be_changed_by_accident() -> None:
    assert not FIRST_COV.flags.writeable
