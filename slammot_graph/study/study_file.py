"""The file of a study: which logs and scenarios, methods, overrides and seeds."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from slammot_graph.core.checks import Checked, Count, CountOrZero, NotNegative, Positive, Share
from slammot_graph.core.config import from_plain
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.files import MOST_SETTINGS_BYTES, check_regular

BUILT_IN = Path(__file__).parent / "builtin"
Seeds = int | tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class ScenarioSpec(Checked):
    """A scenario of the simulator, and what is changed of it.

    Attributes
    ----------
    name : str
    label : str, optional
        How tables name it.
    people, laps : int, optional
    noise_scale : float
        Factor on the odometry's errors.
    rate_hz : float, optional
    laser : str, optional
    sweep : float, optional
    seeds : int or tuple of int, optional
        In place of the study's.
    """

    name: str
    label: str | None = None
    people: CountOrZero | None = None
    noise_scale: NotNegative = 1.0
    rate_hz: Positive | None = None
    laps: Count | None = None
    laser: str | None = None
    sweep: Share | None = None
    seeds: Seeds | None = None


@dataclass(frozen=True, kw_only=True)
class LogSpec(Checked):
    """A recorded log, and what is known of it; paths are relative to the study's file.

    Attributes
    ----------
    path : Path
    label : str, optional
        How tables name it.
    relations, truth : Path, optional
        True relations, true poses (TUM).
    people : int
        Are put in, by seed, at the poses of `trajectory` (TUM).
    trajectory : Path, optional
    odometry : bool
    max_scans : int, optional
    seeds : int or tuple of int, optional
        In place of the study's; a log without people in it has one run.
    """

    path: Path
    label: str | None = None
    relations: Path | None = None
    truth: Path | None = None
    people: CountOrZero = 0
    trajectory: Path | None = None
    odometry: bool = True
    max_scans: Count | None = None
    seeds: Seeds | None = None

    def __post_init__(self) -> None:
        """See `Checked`."""
        super().__post_init__()
        self.require(
            not self.people or self.trajectory is not None,
            "must be given where people are put in: the poses of a run, its trajectory.tum",
            key="trajectory",
        )


@dataclass(frozen=True, kw_only=True)
class MethodSpec:
    """A method of one's own: one of the registry with settings changed.

    Attributes
    ----------
    name : str
    base : str
    config : mapping
        As in a file for `run --config`.
    """

    name: str
    base: str = "graph"
    config: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class OverrideSpec:
    """Settings that are changed in methods of the study; each method also runs without it.

    Attributes
    ----------
    name : str
    methods : tuple of str
        Which ones; empty: all.
    config : mapping
        As in a file for `run --config`.
    """

    name: str
    methods: tuple[str, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class QuickSpec:
    """What `--quick` leaves of a study.

    Attributes
    ----------
    seeds : int
    worlds : tuple of str
        Labels of scenarios and logs; empty: all.
    """

    seeds: Count = 2
    worlds: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Study(Checked):
    """A study.

    Attributes
    ----------
    title : str
    methods : tuple of str
        Names of the registry, or of `method`.
    reference : str, optional
        Method that the others are compared with; by default the first one.
    seeds : int or tuple of int
        So many from 0 on, or these.
    measures : tuple of str
        Columns of the report; the first one is tested. Empty: all that there are.
    pictures : tuple of str
        Methods whose maps of the first seed are drawn, for each scenario.
    scenario, log, method, override : tuples
    quick : QuickSpec
    """

    title: str = ""
    methods: tuple[str, ...] = ("graph",)
    reference: str | None = None
    seeds: Seeds = 1
    measures: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()
    scenario: tuple[ScenarioSpec, ...] = ()
    log: tuple[LogSpec, ...] = ()
    method: tuple[MethodSpec, ...] = ()
    override: tuple[OverrideSpec, ...] = ()
    quick: QuickSpec = field(default_factory=QuickSpec)


def read_study(path: Path) -> Study:
    """Read a study's file; a word that is no file names one that comes with the package.

    Raises
    ------
    ConfigError
        It cannot be read, is not TOML, holds a key that does not exist or a value that does not fit.
    """
    path = study_path(path)
    check_regular(path, MOST_SETTINGS_BYTES)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not valid TOML: {' '.join(str(error).split())}") from None
    free = {kind: _free_tables(values, kind, path) for kind in ("method", "override")}
    study = from_plain(values, Study(), source=str(path))
    study = _with_config(study, free)
    _check(study, path)
    return study


def study_path(path: Path) -> Path:
    """Where the file is that a command line names."""
    if path.suffix or path.is_file():
        return path
    built_in = BUILT_IN / f"{path}.toml"
    if len(path.parts) == 1 and built_in.is_file():
        return built_in
    known = ", ".join(sorted(one.stem for one in BUILT_IN.glob("*.toml")))
    raise ConfigError(f"{path}: neither a file nor a study that comes with the package ({known})")


def quick(study: Study) -> Study:
    """What is left of a study by `--quick`."""
    few, worlds = study.quick.seeds, study.quick.worlds

    def cut(seeds: Seeds | None) -> Seeds | None:
        return seeds if seeds is None else (min(seeds, few) if isinstance(seeds, int) else seeds[:few])

    return replace(
        study,
        seeds=cut(study.seeds) or 1,
        scenario=tuple(
            replace(one, seeds=cut(one.seeds))
            for one in study.scenario
            if not worlds or (one.label or one.name) in worlds
        ),
        log=tuple(
            replace(one, seeds=cut(one.seeds))
            for one in study.log
            if not worlds or (one.label or one.path.name) in worlds
        ),
    )


def _free_tables(values: dict[str, Any], kind: str, path: Path) -> list[dict[str, Any]]:
    """Take the settings out of the tables of a kind: their keys are those of a method."""
    tables = values.get(kind, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{path}: {kind}: expected tables [[{kind}]]")
    found = [table.pop("config", {}) for table in tables]
    if not all(isinstance(one, dict) for one in found):
        raise ConfigError(f"{path}: {kind}: config must be a table [{kind}.config]")
    return found


def _with_config(study: Study, free: Mapping[str, list[dict[str, Any]]]) -> Study:
    return replace(
        study,
        method=tuple(replace(one, config=c) for one, c in zip(study.method, free["method"], strict=True)),
        override=tuple(
            replace(one, config=c) for one, c in zip(study.override, free["override"], strict=True)
        ),
    )


def _check(study: Study, path: Path) -> None:
    """Refuse names that are there twice or not at all, and a study without a log."""
    if not study.scenario and not study.log:
        raise ConfigError(f"{path}: no [[scenario]] and no [[log]]; name at least one")
    if not study.methods:
        raise ConfigError(f"{path}: methods is empty; name at least one")
    worlds = [*(one.label or one.name for one in study.scenario)]
    worlds += [one.label or one.path.name for one in study.log]
    overrides = ["", *(one.name for one in study.override)]
    own = [one.name for one in study.method]
    lists = (("world", worlds), ("method", [*study.methods]), ("override", overrides), ("[[method]]", own))
    for what, names in lists:
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            text = f"{path}: the {what} {twice[0]!r} is there twice; give each a label or name of its own"
            raise ConfigError(text)
    _check_references(study, worlds, path)


def _check_references(study: Study, worlds: list[str], path: Path) -> None:
    referred = [*([study.reference] if study.reference else []), *study.pictures]
    for name in (*referred, *(method for one in study.override for method in one.methods)):
        if name not in study.methods:
            raise ConfigError(f"{path}: {name!r} is not among the methods of the study")
    for world in study.quick.worlds:
        if world not in worlds:
            raise ConfigError(f"{path}: quick.worlds: no scenario or log {world!r}")
    for seeds in (
        study.seeds,
        *(scenario.seeds for scenario in study.scenario),
        *(log.seeds for log in study.log),
    ):
        _check_seeds(seeds, path)


def _check_seeds(seeds: Seeds | None, path: Path) -> None:
    several = seeds if isinstance(seeds, tuple) else ()
    if (isinstance(seeds, int) and seeds < 1) or any(seed < 0 for seed in several) or seeds == ():
        raise ConfigError(f"{path}: seeds must be a number from 1 on or a list of numbers from 0 on")
    if len(set(several)) < len(several):
        raise ConfigError(f"{path}: seeds: one is there twice")
