"""The pieces of a study, on as many processors as there are."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple, TypeVar

from hil.scenario.play import Advance

MOST_WORKERS = 4
Key = TypeVar("Key", bound=Hashable)


class Work(NamedTuple):
    """One piece of work, which any process can do."""

    function: Callable[..., Any]
    """Of a module, so that its name can be sent to another process."""
    arguments: tuple[Any, ...]
    title: str
    """What the progress bar says once it is done."""
    cost: float = 1.0
    """In the unit of the progress bar's total."""


def play(
    pieces: Mapping[Key, Work],
    advance: Advance,
    *,
    keep: Callable[[Key, Any], None] | None = None,
    pieces_per_worker: int = 1,
    start: Callable[..., None] | None = None,
    start_arguments: tuple[Any, ...] = (),
) -> dict[Key, Any]:
    """Results of all pieces by key, in the order of ``pieces``, in which they are begun too.

    Args:
        pieces: the work; begin with what takes long, so that no processor is left alone with it at the end.
        advance: called after each piece with its cost and title.
        keep: called in this process with each key and result as it comes, before ``advance``.
        pieces_per_worker: fewest pieces that are worth a process.
        start: called once in every process before its first piece, with ``start_arguments``.
    """
    workers = min(MOST_WORKERS, os.cpu_count() or 1, len(pieces) // pieces_per_worker)
    found: dict[Key, Any] = {}
    if workers < 2:
        if start is not None:
            start(*start_arguments)
        for key, piece in pieces.items():
            found[key] = piece.function(*piece.arguments)
            if keep is not None:
                keep(key, found[key])
            advance(piece.cost, piece.title)
        return found
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, spawn, initializer=start, initargs=start_arguments)
    try:
        futures = {pool.submit(piece.function, *piece.arguments): key for key, piece in pieces.items()}
        for future in as_completed(futures):
            key = futures[future]
            found[key] = future.result()
            if keep is not None:
                keep(key, found[key])
            advance(pieces[key].cost, pieces[key].title)
    finally:  # once: a second call, as that of `with`, takes back that the pieces not begun are cancelled
        pool.shutdown(cancel_futures=True)
    return {key: found[key] for key in pieces}
