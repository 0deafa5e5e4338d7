"""A file of settings of an earlier release, given to `run`."""

import json
from pathlib import Path

import pytest

from tests.cli.test_cli import run, write_box_log


def test_old_keys_are_taken_with_one_line_that_names_the_new_ones(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log, settings, output = tmp_path / "box.log", tmp_path / "old.toml", tmp_path / "out"
    write_box_log(log)
    settings.write_text("n_lost = 3\n[motion]\nn_sigma = 3.0\n")
    code, _, err = run(capsys, "run", log, "--rerun", "off", "--config", settings, "--output", output)
    assert code == 0
    (line,) = (line for line in err.splitlines() if line.startswith("warning: "))
    assert line == (
        f"warning: {settings}: these keys have moved, the next release will not know them: "
        "n_lost -> localizer.n_lost, motion -> detector.ellipse_test"
    )
    config = json.loads((output / "summary.json").read_text())["config"]
    assert config["localizer"]["n_lost"] == 3
    assert config["detector"]["ellipse_test"]["n_sigma"] == 3.0
