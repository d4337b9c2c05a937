"""Where runs are made: on this machine, or on others by Dask.

A task of Dask supervises a process, for MPI and PETSc must not live in a worker. Dask does what
many machines need: it gives each worker as many tasks as it has threads, and gives the tasks of a
worker that has died to others. There a run goes on from its last checkpoint: that of the results
directory where both machines see it, else the one that the scheduler keeps. On one machine a pool
of threads does the same, with no scheduler to start, to reach and to lose.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import shlex
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

from wovenfab.case import Case, case_error
from wovenfab.case.document import parse_document
from wovenfab.case.fingerprint import case_files
from wovenfab.record.results import (
    CHECKPOINT,
    COMMAND,
    EARLIER_CHECKPOINT,
    INPUT,
    write_whole,
)
from wovenfab.study.runner import Command, Ended, Submit, goes_on, here, run_command

logger = logging.getLogger(__name__)
LOCAL, SLURM = "local", "slurm"
#: ``Problem.file`` of what is wrong with a cluster.
OPTION = "--cluster"
#: Loggers that Dask gives levels of their own, and asyncio's: what matters is told here.
_QUIET = "distributed", "distributed.client", "tornado.application", "asyncio"
#: Seconds in which a scheduler must answer.
_ANSWER = 10
#: Most jobs of Slurm, and memory of a rank (GiB), unless the user says something else.
_JOBS, _MEMORY = 8, 2
#: How often a run that was stopped on its machine is tried again; dead workers do not count.
_RETRIES = 5
#: Case file, results directory and log of a command that is run elsewhere.
CASE, RESULTS, LOG = "case.yaml", "results", "log"


@dataclass(frozen=True)
class Cluster:
    """Where commands are run.

    Attributes:
        name: ``local``, ``slurm`` or the address of a scheduler.
        jobs: Number of commands side by side; None for as many as fit.
        ranks: Number of MPI ranks of each.
    """

    name: str = LOCAL
    jobs: int | None = None
    ranks: int = 1

    @property
    def is_local(self) -> bool:
        """Whether all is run on this machine."""
        return self.name == LOCAL

    @property
    def side_by_side(self) -> int:
        """Number of commands that this machine runs at a time."""
        return self.jobs or max(len(os.sched_getaffinity(0)) // self.ranks, 1)

    @contextmanager
    def open(self, shared: Path) -> Iterator[Submit]:
        """Yield what runs a command and returns the future of its end; at last nothing is left.

        Args:
            shared: Folder of the results, which is made; other machines look whether they see it.

        Raises:
            CaseError: There is no such cluster, or it does not answer.
        """
        if self.is_local:
            shared.mkdir(parents=True, exist_ok=True)
            with here(self.side_by_side) as submit:
                yield submit
            return
        with self._client() as client, _mark(shared) as mark:
            executor = client.get_executor(pure=False, retries=_RETRIES)
            yield lambda command: _told(executor.submit(run_there, command, *mark), self.name)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        """Yield a client of the scheduler."""
        if self.name != SLURM and "://" not in self.name:
            remedy = f"It can be {LOCAL}, {SLURM} or an address such as tcp://10.0.0.1:8786."
            raise case_error(OPTION, f"there is no cluster {self.name!r}", remedy)
        if self.name != SLURM and self.jobs is not None:
            remedy = "Leave --jobs out: a worker runs as many at a time as it has threads."
            raise case_error(OPTION, "the workers decide how many runs go side by side", remedy)
        from distributed import Client

        for name in _QUIET:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with (
            _slurm(self.jobs or _JOBS, self.ranks)
            if self.name == SLURM
            else _scheduler(self.name) as at,
            Client(at, timeout=_ANSWER, set_as_default=False) as client,
        ):
            client.subscribe_topic("all", partial(_warn_of_lost_worker, client))
            yield client


def _warn_of_lost_worker(client: Any, event: tuple[float, Mapping[str, Any]]) -> None:
    """Say which worker was lost with tasks of a client, by an event of the scheduler."""
    message = event[1]
    if message.get("action") == "remove-worker":
        ours = len(set(message.get("processing-tasks", ())) & set(client.futures))
        if ours:
            text = "the worker at %s was lost; runs that go on with another one: %d"
            logger.warning(text, message["worker"], ours)


@contextmanager
def _scheduler(address: str) -> Iterator[str]:
    """Yield an address at which a scheduler answers: a client would wait for any answer."""
    from distributed import rpc

    async def identify() -> None:
        async with asyncio.timeout(_ANSWER), rpc(address) as scheduler:
            await scheduler.identity()

    try:
        with ThreadPoolExecutor(1) as own:  # a notebook has a loop of its own in this thread
            own.submit(lambda: asyncio.run(identify())).result()
    except (OSError, ValueError, OverflowError, ImportError) as error:
        remedy = "Start one with 'dask scheduler', and workers with 'dask worker ADDRESS'."
        raise case_error(OPTION, f"no scheduler answers at {address}", remedy) from error
    yield address


@contextmanager
def _slurm(jobs: int, ranks: int) -> Iterator[Any]:
    """Yield a cluster of Slurm's jobs, a worker each, as many as there is work for."""
    try:
        from dask_jobqueue import SLURMCluster
    except ModuleNotFoundError:
        remedy = "Install it (pip install dask-jobqueue), or start scheduler and workers yourself."
        raise case_error(OPTION, "slurm needs dask-jobqueue, which is missing", remedy) from None
    from dask import config

    memory = config.get("jobqueue.slurm.memory", None) or f"{_MEMORY * ranks} GiB"
    with SLURMCluster(cores=1, processes=1, job_cpu=ranks, memory=memory) as cluster:
        cluster.adapt(maximum_jobs=jobs)
        yield cluster


@contextmanager
def _mark(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield a file in a folder and its text, by which others know that they see the same folder."""
    folder.mkdir(parents=True, exist_ok=True)
    text = uuid4().hex
    mark = folder.absolute() / f".seen-{text}"
    mark.write_text(text, encoding="utf-8")
    try:
        yield mark, text
    finally:
        mark.unlink(missing_ok=True)


def _told(of_task: Future[Ended], cluster: str) -> Future[Ended]:
    """Return the future of how a command ends, also where Dask cannot run it."""
    told: Future[Ended] = Future()

    def tell(ended: Future[Ended]) -> None:
        if ended.cancelled():
            remedy = "Start one again and repeat the command: what is done is kept."
            told.set_exception(case_error(OPTION, f"the scheduler of {cluster} has ended", remedy))
        elif (error := ended.exception()) is not None:
            why = f"{type(error).__name__}: {error}".splitlines()[0]
            told.set_result(Ended(1, "", "", 0.0, f"{why} (docs/cluster.md has what workers need)"))
        else:
            told.set_result(ended.result())

    of_task.add_done_callback(tell)
    return told


def run_there(command: Command, mark: Path, text: str) -> Ended:
    """Run a command in a task of Dask.

    Args:
        command: The command.
        mark: A file beside the results.
        text: What it says where this machine sees the files of the other one.
    """
    folder = command.folder or Path()
    seen = folder.is_dir() and mark.is_file() and mark.read_text(encoding="utf-8") == text
    if command.elsewhere is not None and not seen:
        return _run_elsewhere(command.elsewhere)
    ended = run_command(command, _is_cancelled)
    _try_again_if_stopped(ended, command, folder)
    return ended


def _try_again_if_stopped(ended: Ended, command: Command, folder: Path) -> None:
    """Raise what makes Dask try again where a run was stopped, such as at the end of a job."""
    if ended.failure and command.results and goes_on(command, folder):
        raise InterruptedError(ended.failure)


def _is_cancelled() -> bool:
    """Return whether nobody waits for this task any more: its client has left, or was killed."""
    from distributed import get_worker

    worker = get_worker()
    task = worker.state.tasks.get(worker.get_current_task())
    return task is None or task.state == "cancelled"


def _run_elsewhere(command: Command) -> Ended:
    """Run a command in a folder of its own; the scheduler keeps its last checkpoint."""
    from distributed import Variable

    kept, sent = Variable(f"wovenfab-{command.environment[INPUT]}"), 0.0
    with TemporaryDirectory() as own:
        folder, before = Path(own), {}
        with suppress(TimeoutError):
            before = kept.get(timeout="0.1 s")
        checkpoint = folder / RESULTS / CHECKPOINT

        def look() -> bool:
            nonlocal sent
            with suppress(OSError):
                if (written := checkpoint.stat().st_mtime) != sent:
                    sent = written
                    kept.set(_written(folder))
            return _is_cancelled()

        files = {**command.files, **before}
        ended = run_command(replace(command, folder=folder, files=files), look)
        look()
        _try_again_if_stopped(ended, command, folder)
        kept.delete()
        return replace(ended, files=_written(folder))


def _written(folder: Path) -> dict[str, bytes]:
    """Return what a command has written in its folder, its checkpoints first.

    What a run writes meanwhile is later than they are: it is cut back when a run goes on.
    """
    results = folder / RESULTS
    first = [results / name for name in (CHECKPOINT, EARLIER_CHECKPOINT)]
    files = {}
    for path in dict.fromkeys([*first, *results.rglob("*"), folder / LOG]):
        with suppress(OSError):
            files[str(path.relative_to(folder))] = path.read_bytes()
    if case := files.get(f"{RESULTS}/{CASE}"):  # with the names of files as they were sent
        files[f"{RESULTS}/{CASE}"] = case.replace(f"{folder}/".encode(), b"")
    return files


def command_of(case: Case, results: Path, log: Path, known: str, ranks: int, sent: bool) -> Command:
    """Return the command that runs a case.

    Args:
        case: The case, read from a file.
        results: The results directory; see :attr:`Command.results`.
        log: File for all output.
        known: The fingerprint of the case.
        ranks: Number of MPI ranks.
        sent: Whether machines that do not see the files of this one may run it.
    """
    run_case, variables = ["-m", "wovenfab", "run"], {INPUT: known}
    overrides = [word for text in case.overrides for word in ("--set", text)]
    test, *fabrics = map(str, case.files)
    fabric = [word for file in fabrics for word in ("--fabric", file)]
    arguments = [*run_case, test, *fabric, "-o", str(results), *overrides]
    elsewhere = None
    if sent:
        elsewhere = Command(
            [*run_case, CASE, "-o", RESULTS],
            ranks,
            Path(LOG),
            environment=variables | {COMMAND: shlex.join(arguments[1:])},
            results=Path(RESULTS),
            files=portable(case),
        )
    folder = Path.cwd() if sent else None
    return Command(arguments, ranks, log, inf, variables, folder, results, elsewhere=elsewhere)


def portable(case: Case) -> dict[str, bytes]:
    """Return the contents of a case file and of the files that it names, by relative names."""
    text, files = json.dumps(parse_document(case.to_yaml(), "").data), dict[str, bytes]()
    for name, path in _sent_names(case).items():
        text = text.replace(json.dumps(str(path)), json.dumps(name))
        parts = [path / n for n in (CHECKPOINT, EARLIER_CHECKPOINT)] if path.is_dir() else [path]
        files |= {
            f"{name}/{p.name}" if p != path else name: p.read_bytes() for p in parts if p.is_file()
        }
    return {CASE: text.encode(), **files}


def _sent_names(case: Case) -> dict[str, Path]:
    """Return the files and folders that a case names, by the names that they are sent under."""
    paths = [*case_files(case), *([case.from_state] if case.from_state else [])]
    return {f"{number}/{path.name}": path for number, path in enumerate(paths)}


def take(ended: Ended, case: Case, results: Path, log: Path) -> None:
    """Write what a command has left elsewhere to where :func:`command_of` said."""
    for name, content in ended.files.items():
        place = log if name == LOG else results / Path(name).relative_to(RESULTS)
        if name == f"{RESULTS}/{CASE}":
            for sent, path in _sent_names(case).items():
                content = content.replace(sent.encode(), str(path).encode())
        place.parent.mkdir(parents=True, exist_ok=True)
        write_whole(place, content)
