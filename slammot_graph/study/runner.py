"""The one loop of all studies and experiments: cells to workers, outcomes back, whatever happens to the workers."""

import itertools
import queue
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from slammot_graph.study.cells import Cell, Outcome, Task
from slammot_graph.study.data_files import DataFile

MOST_SECONDS = 30.0
"""Cells of one input that one process gets in one piece take no longer than this, as far as is known."""
MOST_CELLS = 64
MOST_UNKNOWN = 4
"""The same while nothing is known."""
MOST_STRIKES = 3
"""A cell during which so many processes died has failed; from one less on it runs alone."""
_POLL_S = 1.0


class WorkerDiedError(Exception):
    """The process that computed this task is gone."""


class PoolBrokenError(Exception):
    """All processes are gone, with all that was in flight; one of the tasks is the reason."""


class ConnectionLostError(Exception):
    """The scheduler is gone; no task is the reason."""


Answer = list[Outcome] | WorkerDiedError | PoolBrokenError | ConnectionLostError


class Workers(Protocol):
    """Where tasks are computed."""

    @property
    def n(self) -> int:
        """How many tasks are computed at a time."""

    def submit(self, task: Task, done: Callable[[Answer], None]) -> None:
        """Have a task computed; `done` is called once with what became of it, from any thread."""

    def is_alive(self) -> bool:
        """Tell whether what was submitted may still be answered."""

    def restart(self) -> None:
        """Make it usable again after it broke or the connection was lost.

        Raises
        ------
        InputError
            It cannot.
        """

    def provide(self, file: DataFile) -> None:
        """Bring a file to where it is missing."""

    def close(self) -> None:
        """Stop everything, also what is being computed."""


@dataclass(eq=False)
class Times:
    """How long cells take, by their kind."""

    seconds: dict[str, float] = field(default_factory=dict)
    count: dict[str, int] = field(default_factory=dict)

    def add(self, kind: str, seconds: float) -> None:
        """Learn from a finished cell."""
        self.seconds[kind] = self.seconds.get(kind, 0.0) + seconds
        self.count[kind] = self.count.get(kind, 0) + 1

    def expected(self, kind: str) -> float | None:
        """Mean of the kind, else of all; None where nothing is known [s]."""
        if kind in self.count:
            return self.seconds[kind] / self.count[kind]
        total = sum(self.count.values())
        return sum(self.seconds.values()) / total if total else None

    def left(self, n_by_kind: dict[str, int], n_workers: int) -> float | None:
        """Time that so many cells of each kind still take [s]."""
        parts = [(n, self.expected(kind)) for kind, n in n_by_kind.items() if n]
        if any(each is None for _, each in parts):
            return None
        return sum(n * (each or 0.0) for n, each in parts) / max(n_workers, 1)


def compute(
    cells: Sequence[Cell], workers: Workers, times: Times | None = None
) -> Generator[Outcome, None, None]:
    """Compute cells and give the outcome of each as soon as it is there, in any order.

    Cells in a row of one `group` go to one process together, so that it makes their input once. A process that
    dies loses no cell: what it had is computed again, one cell at a time.
    """
    loop = _Loop(cells, workers, times or Times())
    try:
        yield from loop.run()
    finally:
        workers.close()


@dataclass(eq=False)
class _Loop:
    cells: Sequence[Cell]
    workers: Workers
    times: Times
    pending: deque[Cell] = field(default_factory=deque)
    in_flight: dict[int, Task] = field(default_factory=dict)
    strikes: dict[str, int] = field(default_factory=dict)
    provided: set[tuple[str, str]] = field(default_factory=set)
    answers: "queue.SimpleQueue[tuple[int, Answer]]" = field(default_factory=queue.SimpleQueue)
    tickets: Iterator[int] = field(default_factory=itertools.count)

    def run(self) -> Iterator[Outcome]:
        self.pending.extend(self.cells)
        while self.pending or self.in_flight:
            self._submit()
            try:
                ticket, answer = self.answers.get(timeout=_POLL_S)
            except queue.Empty:
                if not self.workers.is_alive():
                    self._requeue()
                    self.workers.restart()
                continue
            if ticket in self.in_flight:
                yield from self._take(ticket, answer)

    def _take(self, ticket: int, answer: Answer) -> Iterator[Outcome]:
        if isinstance(answer, list):
            del self.in_flight[ticket]
            for outcome in answer:
                if not self._is_mended(outcome):
                    self.times.add(outcome.cell.kind, outcome.seconds)
                    yield outcome
        elif isinstance(answer, WorkerDiedError):
            yield from self._struck(self.in_flight.pop(ticket))
        elif isinstance(answer, PoolBrokenError):
            tasks, self.in_flight = list(self.in_flight.values()), {}
            self.workers.restart()
            yield from self._struck([cell for task in tasks for cell in task])
        else:
            self._requeue()
            self.workers.restart()

    def _is_mended(self, outcome: Outcome) -> bool:
        """Bring a missing file to the workers, once for each cell."""
        if outcome.missing is None or (outcome.cell.digest, outcome.missing.digest) in self.provided:
            return False
        self.provided.add((outcome.cell.digest, outcome.missing.digest))
        self.workers.provide(outcome.missing)
        self.pending.appendleft(outcome.cell)
        return True

    def _struck(self, cells: Task) -> Iterator[Outcome]:
        """A process died with these cells; who has seen that too often has failed."""
        for cell in reversed(cells):
            self.strikes[cell.digest] = self.strikes.get(cell.digest, 0) + 1
            if self.strikes[cell.digest] >= MOST_STRIKES:
                yield Outcome(
                    cell=cell,
                    error=f"its process died {MOST_STRIKES} times, at last with nothing else in it: killed, or out of"
                    " memory",
                )
            else:
                self.pending.appendleft(cell)

    def _requeue(self) -> None:
        for task in self.in_flight.values():
            self.pending.extendleft(reversed(task))
        self.in_flight = {}

    def _submit(self) -> None:
        """Keep every process busy, with one task waiting for each."""
        n = self.workers.n
        window = 2 * n if n > 1 else 1
        while self.pending and len(self.in_flight) < window:
            is_suspect = self.strikes.get(self.pending[0].digest, 0) >= MOST_STRIKES - 1
            if self.in_flight and (is_suspect or self._has_suspect()):
                return
            task = self._next_task(n)
            ticket = next(self.tickets)
            self.in_flight[ticket] = task
            self.workers.submit(task, partial(self._answer, ticket))

    def _answer(self, ticket: int, answer: Answer) -> None:
        self.answers.put((ticket, answer))

    def _has_suspect(self) -> bool:
        return any(
            self.strikes.get(cell.digest, 0) >= MOST_STRIKES - 1
            for task in self.in_flight.values()
            for cell in task
        )

    def _next_task(self, n_workers: int) -> Task:
        """Take the next cells of one group, fewer at the end, so that all processes end together."""
        first = self.pending.popleft()
        task = [first]
        if self.strikes.get(first.digest):
            return task
        each = self.times.expected(first.kind)
        most_s = MOST_SECONDS
        if each is not None:
            most_s = min(most_s, each * len(self.pending) / (4 * n_workers))
        spent = each or 0.0
        while self.pending and len(task) < (MOST_CELLS if each is not None else MOST_UNKNOWN):
            cell = self.pending[0]
            expected = self.times.expected(cell.kind) or 0.0
            is_like = cell.group == first.group != "" and not self.strikes.get(cell.digest)
            is_small = (
                each is not None and spent + expected < 0.1
            )  # the way there and back costs a millisecond
            if not (is_small or (is_like and spent + expected <= most_s)):
                break
            spent += expected
            task.append(self.pending.popleft())
        return task
