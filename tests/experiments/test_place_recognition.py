"""The comparison of two methods of place recognition: quick mode, and its parts on made figures."""

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import place_recognition
from experiments.common import main
from experiments.place_recognition import Answer
from slammot_graph.core.errors import InputError


def test_quick_mode(tmp_path: Path) -> None:
    pytest.importorskip("map_closures.map_closures")
    arguments = ["--quick", "--jobs", "1", "--output", str(tmp_path)]
    assert main(place_recognition.experiment, arguments) == 0
    text = (tmp_path / "tables" / "place_recognition.md").read_text(encoding="utf-8")
    assert "Quick mode" in text
    assert "**Recall at full precision.** lab:" in text
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    ours = {cells[1]: cells for cells in rows if cells[0] == "search, verified (ours)"}
    assert list(ours) == ["1", "3", "6", "elsewhere"]
    assert ours["1"][4].endswith("(100%)")
    assert any(cells[0] == "density maps, verified" for cells in rows)
    main(place_recognition.experiment, arguments)  # the finished cell is read again
    assert (tmp_path / "tables" / "place_recognition.md").read_text(encoding="utf-8") == text


def test_without_the_package_there_is_a_clear_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError, match="pip install"):
        place_recognition.map_closures()
    assert main(place_recognition.experiment, ["--quick", "--output", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_disturbed_by_the_drift_and_20_degrees_at_most() -> None:
    rng = np.random.default_rng(0)
    T = np.array([1.0, -2.0, 3.0])
    offsets = np.array([place_recognition.disturbed(T, 3.0, rng) - T for _ in range(200)])
    assert np.hypot(offsets[:, 0], offsets[:, 1]) == pytest.approx(np.full(200, 3.0))
    assert 15.0 < np.degrees(np.abs(offsets[:, 2]).max()) <= 20.0


def test_summary_counts_right_and_wrong_by_stratum() -> None:
    right, wrong = np.array([0.3, 0.0, math.radians(4.0)]), np.array([0.0, 0.0, math.radians(6.0)])
    answers = [
        Answer(T_target_source=right, n_inliers=9, ms=1.0),
        Answer(T_target_source=right, n_inliers=4, ms=2.0),
        Answer(T_target_source=wrong, n_inliers=6, ms=3.0),
        Answer(T_target_source=None, ms=4.0),
    ]
    strata = ["same", "opposite", "negative", "same"]
    truth = [np.zeros(3)] * 4
    score = place_recognition.summary(strata, answers, truth)
    assert score == {"accepted": 3, "right": 2, "same": 1, "opposite": 1, "negative": 0, "ms": 2.5}
    assert place_recognition.summary(strata, answers, truth, 5)["accepted"] == 2
    least = place_recognition.least_precise(
        {
            "alone": {
                str(n): place_recognition.summary(strata, answers, truth, n)
                for n in range(place_recognition.MIN_INLIERS, place_recognition.MAX_INLIERS + 1)
            }
        }
    )
    assert least is not None
    assert least[0] == 7


def made(ours: tuple[int, int], theirs: int, n_wrong: int) -> dict[str, Any]:
    """Scores of a log with 10 positives: what ours finds at two drifts, and what density maps find."""

    def score(found: int, wrong: int = 0) -> dict[str, float]:
        return {"accepted": found + wrong, "right": found, "same": found, "opposite": 0, "negative": 0}

    thresholds = range(place_recognition.MIN_INLIERS, place_recognition.MAX_INLIERS + 1)
    return {
        "n": {"same": 10, "opposite": 0, "negative": 10},
        "search": {"1": {"verified": score(ours[0])}, "6": {"verified": score(ours[1], n_wrong)}},
        "density": {
            "x": {"alone": {str(n): score(theirs) for n in thresholds}, "verified": score(theirs + 1, 1)}
        },
    }


def test_the_conclusion_follows_from_the_figures() -> None:
    def said(*scores: Any) -> str:
        return place_recognition.conclusion({"lab": made(*scores)}, "x")

    assert "lab: the search finds more (ours 90% at 1 m, 80% at 6 m; density maps 50%)." in said((9, 8), 5, 0)
    assert "density maps find more" in said((3, 4), 5, 0)
    assert "it depends on the drift" in said((9, 4), 5, 0)
    wrong = said((9, 8), 5, 2)
    assert "lab: ours is not at full precision" in wrong
    assert wrong.endswith("wrong answers of ours: 2 at 6 m.")
