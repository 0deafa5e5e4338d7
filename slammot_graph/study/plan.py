"""The cells of a study, in an order in which cells of one log follow each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slammot_graph.core.config import from_plain
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.methods import Config, get_method
from slammot_graph.simulation.laser import laser_named
from slammot_graph.simulation.scenarios import scenario_named
from slammot_graph.study.cells import Cell
from slammot_graph.study.code_version import version_of
from slammot_graph.study.data_files import data_file
from slammot_graph.study.measures import config_text
from slammot_graph.study.study_file import LogSpec, ScenarioSpec, Seeds, Study

SIMULATED = "slammot_graph.study.measures:simulated_cell"
RECORDED = "slammot_graph.study.measures:recorded_cell"


@dataclass(frozen=True, kw_only=True)
class Planned:
    """A row of the results, and the cell that it is computed by; several rows may share one.

    Attributes
    ----------
    world, method, override : str
    seed : int or None
        None: nothing is drawn.
    cell : Cell
    """

    world: str
    method: str
    override: str
    seed: int | None
    cell: Cell


@dataclass(frozen=True, kw_only=True)
class _Variant:
    method: str
    override: str
    config: str


def plan(study: Study, folder: Path, *, source: str = "study") -> list[Planned]:
    """Make the rows of a study.

    Parameters
    ----------
    study : Study
    folder : Path
        Paths of logs are relative to it.
    source : str
        The study's file, for messages.

    Raises
    ------
    ConfigError
        A name that does not exist, or settings that do not fit their method.
    InputError
        A file cannot be read.
    """
    variants = _variants(study, source)
    rows: list[Planned] = []
    for scenario in study.scenario:
        rows += _of_scenario(scenario, variants, _seeds(scenario.seeds or study.seeds), source)
    for log in study.log:
        rows += _of_log(log, variants, _seeds(log.seeds or study.seeds), folder)
    return rows


def part_of(rows: list[Planned], number: int, n_parts: int) -> list[Planned]:
    """One of n parts, from 1 on; cells of one log stay together."""
    groups = {group: k for k, group in enumerate(dict.fromkeys(row.cell.group for row in rows))}
    return [row for row in rows if groups[row.cell.group] % n_parts == number - 1]


def _variants(study: Study, source: str) -> list[_Variant]:
    own = {one.name: one for one in study.method}
    found = []
    for name in study.methods:
        try:
            config = get_method(own[name].base if name in own else name).config
        except ConfigError as error:
            raise ConfigError(f"{source}: {error}") from None
        if name in own:
            config = _laid_over(own[name].config, config, f"{source}: method {name}")
        found.append(_Variant(method=name, override="", config=config_text(config)))
        for override in study.override:
            if not override.methods or name in override.methods:
                place = f"{source}: override {override.name} of {name}"
                changed = _laid_over(override.config, config, place)
                found.append(_Variant(method=name, override=override.name, config=config_text(changed)))
    return found


def _laid_over(values: Mapping[str, Any], config: Config, place: str) -> Config:
    return from_plain(values, config, source=place)


def _seeds(seeds: Seeds) -> tuple[int, ...]:
    return tuple(range(seeds)) if isinstance(seeds, int) else seeds


def _of_scenario(
    spec: ScenarioSpec, variants: list[_Variant], seeds: tuple[int, ...], source: str
) -> list[Planned]:
    try:
        scenario = scenario_named(spec.name)
        laser_named(spec.laser or scenario.laser).at_rate(spec.rate_hz or scenario.rate_hz)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None
    options = {
        "n_people": spec.people,
        "noise_scale": spec.noise_scale,
        "rate_hz": spec.rate_hz,
        "n_laps": spec.laps,
        "laser": spec.laser,
        "sweep": spec.sweep,
    }
    options = {name: value for name, value in options.items() if value is not None}
    world, code = spec.label or spec.name, version_of(SIMULATED)
    return [
        _row(
            world,
            variant,
            seed,
            function=SIMULATED,
            code=code,
            arguments={"scenario": spec.name, "seed": seed, "config": variant.config, "options": options},
        )
        for seed in seeds
        for variant in variants
    ]


def _of_log(spec: LogSpec, variants: list[_Variant], seeds: tuple[int, ...], folder: Path) -> list[Planned]:
    named = {"log": spec.path, "relations": spec.relations, "truth": spec.truth}
    if spec.people:
        named["trajectory"] = spec.trajectory
    files = {}
    for name, path in named.items():
        if path is None:
            continue
        if not (folder / path).exists():
            raise InputError(f"{folder / path}: no such file; paths of a study are relative to its own file")
        files[name] = data_file((folder / path).absolute())
    world, code = spec.label or spec.path.name, version_of(RECORDED)
    common = {"people": spec.people, "odometry": spec.odometry, "max_scans": spec.max_scans}
    drawn: tuple[int | None, ...] = seeds if spec.people else (None,)
    return [
        _row(
            world,
            variant,
            seed,
            function=RECORDED,
            code=code,
            files=files,
            arguments={**common, "seed": seed, "config": variant.config},
        )
        for seed in drawn
        for variant in variants
    ]


def _row(world: str, variant: _Variant, seed: int | None, **cell: Any) -> Planned:
    words = [world, variant.method, variant.override, "" if seed is None else f"seed {seed}"]
    return Planned(
        world=world,
        method=variant.method,
        override=variant.override,
        seed=seed,
        cell=Cell(
            key=", ".join(filter(None, words)),
            group=f"{world} {seed}",
            kind=f"{world} {variant.method} {variant.override}",
            **cell,
        ),
    )
