"""Where cells are computed: in this process, in others of this machine, or on a Dask or Ray cluster that is there.

One pure function per cell behind `joblib.Parallel`; the engines do the scheduling.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

__all__ = ["BACKENDS", "Place", "check_place", "compute_all"]

BACKENDS = ("local", "dask", "ray")
_ANSWER_S = 10.0
TRIES = 3
"""How often a cell may take its worker along before it is given up."""


class Place(NamedTuple):
    """Where to compute.

    backend: one of `BACKENDS`.
    workers: processes, or tasks at a time on a cluster; 1 on ``local``: this process.
    address: of a Dask scheduler or a Ray head; empty: a new one on this machine.
    """

    backend: str = "local"
    workers: int = 1
    address: str = ""


def check_place(place: Place) -> None:
    """Refuse a place that cannot be.

    Raises:
        ValueError: an unknown backend, no workers, an address that nobody looks at, or an extra that is missing.
    """
    if place.backend not in BACKENDS:
        raise ValueError(f"--backend: name must be one of {', '.join(BACKENDS)}; got '{place.backend}'. Use local.")
    if place.workers < 1:
        raise ValueError(f"--workers: value must be >= 1; got {place.workers}. Use for example --workers 2.")
    if place.address and place.backend == "local":
        raise ValueError(
            f"--address: option must come with --backend dask or ray; got {place.address} and local. Leave it out."
        )
    needed = {"dask": "distributed", "ray": "ray"}.get(place.backend)
    if needed is not None and importlib.util.find_spec(needed) is None:
        raise ValueError(
            f"--backend: {place.backend} must be installed; got none. Install it: pip install 'jink[cluster]'."
        )


def compute_all(
    compute: Callable[[Any], Any], jobs: Sequence[Any], place: Place, give_up: Callable[[Any, str], Any]
) -> Iterator[tuple[int, Any]]:
    """Results in the order in which they are ready.

    A worker that dies takes along what was in its engine's hands (on ``local`` the cells of all workers); these cells
    are computed again, after two deaths one at a time, so that a cell that ends its worker stands alone.

    Args:
        compute: a pure function of one job; reaches workers by cloudpickle.
        jobs: what to compute.
        place: where.
        give_up: from a job and a reason to its result, for a job that has ended `TRIES` workers.

    Yields:
        index of the job, its result.

    Raises:
        ValueError: the cluster cannot be reached.
    """
    if place.backend == "local" and place.workers == 1:
        for index, job in enumerate(jobs):
            yield index, compute(job)
        return
    _must_answer(place)
    left = dict(enumerate(jobs))
    with _engine(place) as (run, died):
        for _ in range(TRIES - 1):
            try:
                for index, result in run(compute, dict(left)):
                    del left[index]
                    yield index, result
            except died:
                continue
            return
        for index, job in left.items():  # one at a time: whoever ends a worker now is known
            yield index, _alone(run, died, compute, index, job, give_up)


def _must_answer(place: Place) -> None:
    """An address that nobody listens at: the engines would try for minutes."""
    found = re.fullmatch(r"(?:\w+://)?\[?([\w.:-]+?)\]?:(\d+)", place.address)
    if found is None:
        return  # a name that the engine resolves itself, such as auto
    try:
        socket.create_connection((found[1], int(found[2])), timeout=_ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise ValueError(
            f"--address: a {place.backend} cluster must answer; got {place.address} ({error}). "
            "Start one, or leave it out."
        ) from error


Run = Callable[[Callable[[Any], Any], dict[int, Any]], Iterator[tuple[int, Any]]]


def _alone(
    run: Run,
    died: tuple[type[BaseException], ...],
    compute: Callable[[Any], Any],
    index: int,
    job: Any,
    give_up: Callable[[Any, str], Any],
) -> Any:
    reason = ""
    for _ in range(TRIES):
        try:
            return next(result for _, result in run(compute, {index: job}))
        except died as error:
            reason = f"its worker died {TRIES} times ({type(error).__name__})"
    return give_up(job, reason)


def _numbered(compute: Callable[[Any], Any], index: int, job: Any) -> tuple[int, Any]:
    return index, compute(job)


@contextlib.contextmanager
def _engine(place: Place) -> Iterator[tuple[Run, tuple[type[BaseException], ...]]]:
    """A function that runs jobs on an engine, and the exceptions that mean a lost worker."""
    import joblib

    with contextlib.ExitStack() as stack:
        options: dict[str, Any] = {"n_jobs": place.workers}
        pooled = False
        if place.backend == "local":
            from joblib.externals.loky.process_executor import BrokenProcessPool

            died: tuple[type[BaseException], ...] = (BrokenProcessPool,)
            options |= {"backend": "loky", "inner_max_num_threads": 1}
        elif place.backend == "dask":
            died = _start_dask(place, stack)
            options["backend"] = "dask"
        else:
            died, pooled = _start_ray(place), True
            options["backend"] = "ray"

        def run(compute: Callable[[Any], Any], jobs: dict[int, Any]) -> Iterator[tuple[int, Any]]:
            calls = [joblib.delayed(_numbered)(compute, index, job) for index, job in jobs.items()]
            with joblib.parallel_config(**options):
                if not pooled:
                    parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs")
                    yield from parallel(calls)
                    return
            # This engine hands results over in one piece: in portions, so that finished cells are kept.
            size = 4 * place.workers
            for first in range(0, len(calls), size):
                with joblib.parallel_config(**options):
                    done = joblib.Parallel(batch_size=1)(calls[first : first + size])
                yield from done

        yield run, died


def _start_dask(place: Place, stack: contextlib.ExitStack) -> tuple[type[BaseException], ...]:
    from dask import distributed

    Client: Any = distributed.Client  # without types
    LocalCluster: Any = distributed.LocalCluster
    try:
        if place.address:
            stack.enter_context(Client(place.address, timeout="20s"))
        else:
            cluster = LocalCluster(n_workers=place.workers, threads_per_worker=1, dashboard_address=None)
            stack.enter_context(cluster)
            stack.enter_context(Client(cluster))
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"--address: a Dask scheduler must answer; got {place.address or 'none'} "
            f"({' '.join(str(error).split()) or type(error).__name__}). Start dask scheduler, or leave it out."
        ) from error
    return (distributed.KilledWorker,)


def _start_ray(place: Place) -> tuple[type[BaseException], ...]:
    import ray
    from ray.util import joblib as bridge

    if not ray.is_initialized():
        try:
            if place.address:
                ray.init(address=place.address, log_to_driver=False, logging_level=logging.ERROR)
            else:
                ray.init(
                    num_cpus=place.workers, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR
                )
        except (ConnectionError, ValueError, RuntimeError, TimeoutError) as error:
            raise ValueError(
                f"--address: a Ray head must answer; got {place.address or 'none'} "
                f"({' '.join(str(error).split())[:200]}). Start ray start --head, or leave it out."
            ) from error
    register: Any = bridge.register_ray  # without types
    register()
    return (ray.exceptions.RayError,)
