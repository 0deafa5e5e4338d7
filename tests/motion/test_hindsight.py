import numpy as np

from slammot_graph.motion.hindsight import Judged, Judgements
from tests.rooms import take_scan


def test_what_is_kept_comes_back_as_it_was(rng: np.random.Generator) -> None:
    kept, items = Judgements(), []
    for k in range(5):
        scan = take_scan(np.array([2.0, 0.5, 0.1 * k]))
        scan.ranges[::7] = [np.nan, np.inf, 0.0][k % 3]
        masks = rng.random((4, len(scan.ranges))) < 0.4
        item = Judged(
            scan=scan,
            is_valid=masks[0],
            is_moving=masks[1],
            is_wall=masks[2],
            has_walked=masks[3],
            cov_relative=np.diag([1e-5, 2e-5, 3e-6]),
            window=k // 2,
            is_doubtful=k == 3,
        )
        kept.append(item)
        items.append(item)
    assert len(kept) == 5
    for item, back in zip(items, kept, strict=True):
        for name in ("is_valid", "is_moving", "is_wall", "has_walked"):
            np.testing.assert_array_equal(getattr(back, name), getattr(item, name))
        np.testing.assert_allclose(back.scan.ranges, item.scan.ranges, rtol=1e-6)
        np.testing.assert_allclose(back.cov_relative, item.cov_relative, rtol=1e-6)
        assert (back.window, back.is_doubtful, back.scan.stamp) == (
            item.window,
            item.is_doubtful,
            item.scan.stamp,
        )
    assert [item.window for item in kept[1:3]] == [0, 1]
