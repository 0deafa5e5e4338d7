"""A study from its rows to its results: what is finished is read, what is not is computed, all is written."""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from slammot_graph.study.cells import Cell, Outcome
from slammot_graph.study.plan import Planned
from slammot_graph.study.results import write_results
from slammot_graph.study.runner import Times, Workers, compute
from slammot_graph.study.store import CellStore, split


@dataclass(eq=False)
class Progress:
    """How far a study is.

    Attributes
    ----------
    n_cells : int
    done, failed, left : Counter
        Cells by kind; `done` counts those of earlier runs too.
    times : Times
    n_workers : int
    """

    n_cells: int = 0
    done: "Counter[str]" = field(default_factory=Counter)
    failed: "Counter[str]" = field(default_factory=Counter)
    left: "Counter[str]" = field(default_factory=Counter)
    times: Times = field(default_factory=Times)
    n_workers: int = 1

    @property
    def seconds_left(self) -> float | None:
        """By the times of the finished cells; None where nothing is known [s]."""
        return self.times.left(self.left, self.n_workers)

    def start(self, done: Sequence[Cell], todo: Sequence[Cell]) -> None:
        """Take the cells of earlier runs as done."""
        self.n_cells = len(done) + len(todo)
        self.done = Counter(cell.kind for cell in done)
        self.left = Counter(cell.kind for cell in todo)

    def add(self, outcome: Outcome) -> None:
        """Count one."""
        kind = outcome.cell.kind
        self.left[kind] -= 1
        if outcome.scores is None:
            self.failed[kind] += 1
        else:
            self.done[kind] += 1


def finish_cells(
    cells: Sequence[Cell],
    store: CellStore,
    make_workers: Callable[[], Workers],
    *,
    progress: Progress | None = None,
    told: Callable[[Outcome | None], None] = lambda _: None,
    fresh: bool = False,
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Compute the cells that the store has not got; the one loop of studies and experiments.

    Parameters
    ----------
    cells : sequence of Cell
    store : CellStore
    make_workers : callable
        Is called if there is something to compute.
    progress : Progress, optional
        Is kept up to date.
    told : callable
        Is told None once the plan is known, and of each outcome.
    fresh : bool
        Forget what is finished and compute it anew.

    Returns
    -------
    records : dict
        Of the finished cells by digest, see `CellStore.records`.
    errors : dict
        Of those that failed, by digest.

    Raises
    ------
    InputError
        Another process writes into the same file, or the workers are gone for good.
    """
    progress = progress or Progress()
    errors: dict[str, str] = {}
    with store.writing():
        if fresh:
            store.forget(cells)
        records, todo = split(cells, store.records())
        progress.start(
            [cell for cell in {c.digest: c for c in cells}.values() if cell.digest in records], todo
        )
        told(None)
        if not todo:
            return records, errors
        workers = make_workers()
        with closing(compute(todo, workers, progress.times)) as outcomes:
            for outcome in outcomes:
                progress.n_workers = workers.n
                progress.add(outcome)
                if outcome.scores is None:
                    errors[outcome.cell.digest] = outcome.error
                    store.write_error(outcome)
                else:
                    scores = store.write(outcome)
                    records[outcome.cell.digest] = {
                        "cell": outcome.cell.digest,
                        "scores": scores,
                        "seconds": round(outcome.seconds, 4),
                        "host": outcome.host,
                    }
                told(outcome)
    return records, errors


def run_study(
    rows: Sequence[Planned],
    folder: Path,
    origin: dict[str, Any],
    make_workers: Callable[[], Workers],
    *,
    part: tuple[int, int] | None = None,
    progress: Progress | None = None,
    told: Callable[[Outcome | None], None] = lambda _: None,
) -> dict[str, str]:
    """Compute a study, or one part of it, and write its results so far.

    Parameters
    ----------
    rows : sequence of Planned
        Of the whole study.
    folder : Path
        The finished cells are in its folder `cells`.
    origin : dict
        Goes into ``origin.json``.
    make_workers, progress, told
        As for `finish_cells`.
    part : (number, n), optional
        Compute this part only, counted from 1 on; the others may run at the same time on other machines.

    Returns
    -------
    dict
        Errors of the failed cells by their keys.
    """
    from slammot_graph.study.plan import part_of

    mine = list(rows) if part is None else part_of(list(rows), *part)
    shard = "cells" if part is None else f"part-{part[0]}-of-{part[1]}"
    store = CellStore(folder / "cells", shard)
    try:
        _, errors = finish_cells(
            [row.cell for row in mine], store, make_workers, progress=progress, told=told
        )
    finally:  # what there is, also after Ctrl-C
        if (folder / "cells").is_dir():
            everything = CellStore(folder / "cells")
            records = everything.records()
            failed = {cell: error for cell, error in everything.errors().items() if cell not in records}
            write_results(folder, rows, records, failed, origin)
    return {row.cell.key: errors[row.cell.digest] for row in mine if row.cell.digest in errors}
