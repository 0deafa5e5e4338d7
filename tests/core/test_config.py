import enum
import json
import math
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.config import from_plain, load_config, to_plain, to_toml
from slammot_graph.core.errors import ConfigError


class Loss(enum.Enum):
    CAUCHY = "cauchy"
    HUBER = "huber"


@dataclass(frozen=True, kw_only=True)
class Noise:
    sigma_x: float = 0.1
    sigma_y: float = 0.1

    def __post_init__(self) -> None:
        if self.sigma_x < 0.0:
            raise ConfigError(f"sigma_x must not be negative, not {self.sigma_x}")


@dataclass(frozen=True, kw_only=True)
class PointToPoint:
    tau: float = 1e-4


@dataclass(frozen=True, kw_only=True)
class PointToLine:
    kernel_m: float = 0.1
    n_neighbours: int = 5


@dataclass(frozen=True, kw_only=True)
class Closure:
    every: int
    loss: Loss = Loss.CAUCHY


@dataclass(frozen=True, kw_only=True)
class Config:
    noise: Noise = field(default_factory=Noise)
    closure: Closure | None = None
    match: PointToPoint | PointToLine = field(default_factory=PointToLine)
    name: str = "graph"
    mode: Literal["online", "final"] = "online"
    loss: Loss = Loss.HUBER
    n_scans: int = 15
    use_filter: bool = True
    max_range: float | None = None
    label: str | None = None
    folder: Path = Path("runs")
    R_r: tuple[float, float, float] = (0.1, 0.1, 0.05)
    ranges: tuple[int, ...] = (1, 2)
    corners: tuple[tuple[float, str], ...] = ()


floats = st.floats(allow_nan=False)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
configs = st.builds(
    Config,
    noise=st.builds(Noise, sigma_x=st.floats(0.0, math.inf), sigma_y=floats),
    closure=st.none() | st.builds(Closure, every=st.integers(-(2**53), 2**53), loss=st.sampled_from(Loss)),
    match=st.builds(PointToPoint, tau=floats) | st.builds(PointToLine, n_neighbours=st.integers(0, 9)),
    name=texts,
    mode=st.sampled_from(["online", "final"]),
    loss=st.sampled_from(Loss),
    n_scans=st.integers(-(2**53), 2**53),
    use_filter=st.booleans(),
    max_range=st.none() | floats,
    label=st.none() | texts.filter(lambda text: text != "none"),
    folder=st.sampled_from([Path("a/b c"), Path("/x"), Path()]),
    R_r=st.tuples(floats, floats, floats),
    ranges=st.lists(st.integers(-9, 9), max_size=4).map(tuple),
    corners=st.lists(st.tuples(floats, texts), max_size=3).map(tuple),
)


@given(configs, configs)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, c: Config, d: Config
) -> None:
    path = tmp_path_factory.getbasetemp() / "config.toml"
    path.write_text(to_toml(c), encoding="utf-8")
    assert load_config(path, d) == c


@given(configs, configs)
def test_plain_values_pass_through_json(c: Config, d: Config) -> None:
    text = json.dumps(to_plain(c), allow_nan=False)
    assert from_plain(json.loads(text), d) == c


def test_the_text_is_plain_toml() -> None:
    config = Config(closure=Closure(every=3), folder=Path("a b"), corners=((1.0, 'q"'),))
    assert tomllib.loads(to_toml(config)) == {
        "name": "graph",
        "mode": "online",
        "loss": "huber",
        "n_scans": 15,
        "use_filter": True,
        "max_range": "none",
        "label": "none",
        "folder": "a b",
        "R_r": [0.1, 0.1, 0.05],
        "ranges": [1, 2],
        "corners": [[1.0, 'q"']],
        "noise": {"sigma_x": 0.1, "sigma_y": 0.1},
        "closure": {"every": 3, "loss": "cauchy"},
        "match": {"type": "PointToLine", "kernel_m": 0.1, "n_neighbours": 5},
    }
    assert to_plain(config)["max_range"] is None


def load(tmp_path: Path, text: str, default: Config | None = None) -> Config:
    path = tmp_path / "my.toml"
    path.write_text(text)
    return load_config(path, default or Config())


def test_what_is_not_named_stays_as_in_the_default(tmp_path: Path) -> None:
    default = Config(noise=Noise(sigma_x=3.0), n_scans=4, match=PointToLine(kernel_m=9.0))
    text = "n_scans = 5\nmax_range = 8\n[noise]\nsigma_y = 7\n[match]\nn_neighbours = 2\n"
    loaded = load(tmp_path, text, default)
    assert loaded == replace(
        default,
        n_scans=5,
        max_range=8.0,
        noise=Noise(sigma_x=3.0, sigma_y=7.0),
        match=PointToLine(kernel_m=9.0, n_neighbours=2),
    )
    assert isinstance(loaded.max_range, float)
    assert load(tmp_path, "", default) == default


def test_a_part_can_be_taken_out_put_in_and_exchanged(tmp_path: Path) -> None:
    default = Config(closure=Closure(every=1))
    assert load(tmp_path, 'closure = "none"', default).closure is None
    assert load(tmp_path, "[closure]\nevery = 4").closure == Closure(every=4)
    assert load(tmp_path, '[match]\ntype = "PointToPoint"').match == PointToPoint()


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("n_scan = 3", "my.toml: unknown key 'n_scan'; the nearest known key is 'n_scans'"),
        ("[noise]\nsigmax = 1", "my.toml: noise: unknown key 'sigmax'; the nearest known key is 'sigma_x'"),
        ("[closure]\nevry = 1", "my.toml: closure: unknown key 'evry'; the nearest known key is 'every'"),
        ("[noise]\nsigma_x = -1", "my.toml: noise: sigma_x must not be negative, not -1.0"),
        ("n_scans = 1.5", "my.toml: n_scans: expected an integer, not 1.5"),
        (f"n_scans = 1{'0' * 400}", "my.toml: n_scans: integers must lie within +-9007199254740992 (2^53)"),
        (
            f"max_range = -1{'0' * 20}",
            "my.toml: max_range: integers must lie within +-9007199254740992 (2^53)",
        ),
        ("n_scans = true", "my.toml: n_scans: expected an integer, not true"),
        ("use_filter = 1", "my.toml: use_filter: expected true or false, not 1"),
        ('max_range = "far"', 'my.toml: max_range: expected a number, not "far"'),
        ("name = 2024-01-01", "my.toml: name: expected a text, not 2024-01-01"),
        ("folder = 3", "my.toml: folder: expected a path, not 3"),
        ("noise = 3", "my.toml: noise: expected a table, not 3"),
        ("[n_scans]", "my.toml: n_scans: expected an integer, not a table"),
        ('loss = "l2"', "my.toml: loss: expected 'cauchy' or 'huber', not \"l2\""),
        ('mode = "both"', "my.toml: mode: expected 'online' or 'final', not \"both\""),
        ("R_r = [1, 2]", "my.toml: R_r: expected a list of 3 values, not [1, 2]"),
        ("R_r = 1", "my.toml: R_r: expected a list of 3 values, not 1"),
        ("ranges = [1, 2.5]", "my.toml: ranges.1: expected an integer, not 2.5"),
        ('[closure]\nloss = "huber"', "my.toml: closure: needs the key 'every'"),
        (
            '[match]\ntype = "Line"',
            "my.toml: match.type: expected 'PointToPoint' or 'PointToLine', not \"Line\"",
        ),
        ("match = 1", "my.toml: match: expected a table, not 1"),
        ("a = 1\nb = =", "my.toml: not valid TOML: Invalid value (at line 2, column 5)"),
    ],
)
def test_mistakes_are_one_line_that_names_the_place(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    assert str(caught.value) == f"{tmp_path}/{error}"


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none.toml: cannot be read \(No such file or directory\)"):
        load_config(tmp_path / "none.toml", Config())
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_config(tmp_path / "binary.toml", Config())


def test_a_text_that_reads_as_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be kept apart"):
        to_toml(Config(label="none"))
    assert load_plain("none").name == "none"


def load_plain(name: str) -> Config:
    return from_plain(to_plain(Config(name=name)), Config())
