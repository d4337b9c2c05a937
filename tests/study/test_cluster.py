"""Runs on other machines: two workers of Dask, of which one is killed; files shared or not."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from math import inf
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from dask import config as dask_config

from benchmarks.busy import Process, dask_cluster
from tests.study.test_fit import place
from tests.study.test_study_sweep import CASE, processes
from wovenfab.case import CaseError
from wovenfab.record.history import read_history
from wovenfab.record.results import FINISHED, outcome_of
from wovenfab.record.summary import read_summary
from wovenfab.study import cluster as module
from wovenfab.study.cluster import Cluster
from wovenfab.study.fit.fit_file import read_fit
from wovenfab.study.fit.objective import Objective
from wovenfab.study.sweep import TABLE, Sweep, SweepRun, members_of, sweep
from wovenfab.study.variations import grid, read_over

pytestmark = pytest.mark.slow

#: A checkpoint often, so that one is there at the kill.
LONG = CASE.replace("pictures: false", "pictures: false, checkpoint: 4")
STEPS = "program.steps=100,101,102"
type Dask = tuple[str, list[Process], Process]


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[Dask]:
    """Return the address of a scheduler, two workers of one thread each, and the scheduler."""
    with dask_cluster(tmp_path, 2) as cluster:
        yield cluster


def swept(folder: Path, cluster: Cluster, kill: Process | None = None) -> list[SweepRun]:
    """Return the runs of a sweep; a worker is killed once two runs have made many steps."""
    (folder / "case.yaml").write_text(LONG)
    members = members_of([folder / "case.yaml"], grid([read_over(STEPS)]))

    def report(state: Sweep, run: SweepRun | None) -> None:
        begun = [p for p in folder.glob("[tw]*/**/history.csv") if p.read_bytes().count(b"\n") > 30]
        if kill is not None and kill.poll() is None and len(begun) >= 2:
            kill.send_signal(signal.SIGKILL)
            kill.wait()

    return sweep(members, folder / cluster.name.partition(":")[0], cluster, report)


@pytest.mark.parametrize("shared", [True, False])
def test_all_members_complete_though_a_worker_is_killed(
    shared: bool, tmp_path: Path, dask: Dask,
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    @contextmanager
    def nowhere(folder: Path) -> Iterator[tuple[Path, str]]:
        folder.mkdir()
        yield folder / "not there", ""

    if not shared:
        monkeypatch.setattr(module, "_mark", nowhere)
    address, workers, _ = dask
    there = swept(tmp_path, Cluster(address), kill=workers[0])
    assert workers[0].poll() is not None and workers[1].poll() is None
    assert re.search(
        "worker at tcp.* was lost; runs that go on with another one: [12]", caplog.text
    )
    here = swept(tmp_path, Cluster())
    assert [run.state for run in there] == ["finished"] * 3, [run.problem for run in there]
    for one, other in zip(there, here, strict=True):
        a, b = (read_history(run.directory) for run in (one, other))
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
        files = [{p.name for p in run.directory.iterdir()} for run in (one, other)]
        assert files[0] == files[1]
        texts = [(run.directory / "case.yaml").read_text() for run in (one, other)]
        assert texts[0] == texts[1]
    assert max(len(read_summary(run.directory)["parts"]) for run in there) == 2


def test_a_run_that_is_stopped_three_times_on_its_machine_completes(
    tmp_path: Path, dask: Dask
) -> None:
    (tmp_path / "case.yaml").write_text(LONG)
    members = members_of([tmp_path / "case.yaml"], grid([read_over("program.steps=100")]))
    stops = [0.0]

    def stop(state: Sweep, run: SweepRun | None) -> None:
        for checkpoint in (tmp_path / "out").rglob("checkpoint.h5"):
            if len(stops) <= 3 and checkpoint.stat().st_mtime > stops[-1]:
                for number in runs_in(tmp_path):
                    with suppress(ProcessLookupError):
                        os.kill(number, signal.SIGKILL)
                        stops.append(time.time())

    (made,) = sweep(members, tmp_path / "out", Cluster(dask[0]), stop)
    assert (len(stops), made.state) == (4, "finished"), made.problem
    assert len(read_summary(made.directory)["parts"]) == 4


def runs_in(folder: Path) -> list[int]:
    """Return the numbers of the processes of runs in a folder."""
    numbers = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            words = (path / "cmdline").read_bytes().split(b"\0")
            if b"run" in words and any(word.startswith(bytes(folder)) for word in words):
                numbers.append(int(path.name))
    return numbers


def test_nothing_goes_on_when_the_command_is_killed(tmp_path: Path, dask: Dask) -> None:
    (tmp_path / "case.yaml").write_text(LONG)
    arguments = ("case.yaml", "-o", "out", "--over", "program.steps=2000,2001")
    for options in (("--cluster", dask[0]), ("-j", "2")):
        sweeping = [sys.executable, "-m", "wovenfab", "sweep", *arguments, *options]
        running = subprocess.Popen(sweeping, cwd=tmp_path)
        until = time.monotonic() + 120
        histories = [tmp_path / "out" / f"steps={n}" / "history.csv" for n in (2000, 2001)]
        while time.monotonic() < until and not all(h.exists() for h in histories):
            time.sleep(0.1)
        assert len(processes(tmp_path)) >= 2
        running.kill()
        running.wait()
        while time.monotonic() < until and processes(tmp_path):
            time.sleep(0.1)
        assert processes(tmp_path) == []
        shutil.rmtree(tmp_path / "out")


def test_a_scheduler_that_ends_is_told_and_what_is_done_stays(tmp_path: Path, dask: Dask) -> None:
    (tmp_path / "case.yaml").write_text(LONG)
    command = [sys.executable, "-m", "wovenfab", "sweep", "case.yaml", "-o", "out"]
    command += ["--over", "program.steps=20,2000"]
    with subprocess.Popen(
        [*command, "--cluster", dask[0]], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as running:
        until = time.monotonic() + 120
        while time.monotonic() < until and "finished" not in table_in(tmp_path):
            time.sleep(0.1)
        dask[2].kill()
        _, errors = running.communicate(timeout=60)
    assert running.returncode == 2
    assert f"the scheduler of {dask[0]} has ended. Start one again and repeat" in errors
    assert "Traceback" not in errors
    while time.monotonic() < until and processes(tmp_path):
        time.sleep(0.1)
    assert processes(tmp_path) == []
    assert outcome_of(tmp_path / "out" / "steps=20") == FINISHED


def table_in(folder: Path) -> str:
    """Return the table of a sweep, or nothing as long as there is none."""
    table = folder / "out" / TABLE
    return table.read_text() if table.exists() else ""


def test_a_fit_is_the_same_on_a_cluster_and_on_several_ranks(tmp_path: Path, dask: Dask) -> None:
    fit = read_fit(place(tmp_path))
    values = {u.name: u.start for u in fit.unknowns}
    found = []
    for n, cluster in enumerate((Cluster(), Cluster(dask[0]), Cluster(ranks=2))):
        with Objective(fit, tmp_path / str(n), cluster) as objective:
            found.append(objective.evaluate(values))
    np.testing.assert_array_equal(found[0].residuals, found[1].residuals)
    np.testing.assert_array_equal(found[0].jacobian, found[1].jacobian)
    np.testing.assert_allclose(found[0].residuals, found[2].residuals, rtol=1e-8)


@pytest.mark.parametrize("busy", [4.0, inf])
def test_a_scheduler_may_take_some_seconds_to_answer_but_not_half_a_minute(
    busy: float, tmp_path: Path, dask: Dask
) -> None:
    address, _, scheduler = dask
    scheduler.send_signal(signal.SIGSTOP)
    goes_on = threading.Timer(min(busy, 30.0), scheduler.send_signal, [signal.SIGCONT])
    goes_on.start()
    start = time.monotonic()
    try:
        with (
            pytest.raises(CaseError) if busy == inf else nullcontext(),
            Cluster(address).open(tmp_path / "out"),
        ):
            pass
        assert time.monotonic() - start < 20.0
    finally:
        goes_on.cancel()
        scheduler.send_signal(signal.SIGCONT)


@pytest.mark.parametrize(("jobs", "memory"), [(None, None), (3, "5 GB")])
def test_jobs_of_slurm_have_a_processor_and_two_gib_a_rank_unless_the_user_says_otherwise(
    jobs: int | None, memory: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, object] = {}

    class SLURMCluster:
        def __init__(self, **options: object) -> None:
            asked.update(options)

        def __enter__(self) -> SLURMCluster:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def adapt(self, maximum_jobs: int) -> None:
            asked["jobs"] = maximum_jobs
            raise InterruptedError

    monkeypatch.setitem(sys.modules, "dask_jobqueue", SimpleNamespace(SLURMCluster=SLURMCluster))
    with (
        dask_config.set({"jobqueue.slurm.memory": memory}),
        pytest.raises(InterruptedError),
        Cluster("slurm", jobs, ranks=3).open(tmp_path),
    ):
        pass
    assert (asked["job_cpu"], asked["cores"], asked["processes"]) == (3, 1, 1)
    assert (asked["memory"], asked["jobs"]) == (memory or "6 GiB", jobs or 8)


@pytest.mark.parametrize(
    ("cluster", "told"),
    [
        (Cluster("moon"), "there is no cluster 'moon'. It can be local, slurm or an address such"),
        (
            Cluster("tcp://127.0.0.1:1", 2),
            "the workers decide how many runs go side by side. Leave",
        ),
        (Cluster("tcp://127.0.0.1:1"), "no scheduler answers at tcp://127.0.0.1:1. Start one with"),
        (Cluster("slurm"), "slurm needs dask-jobqueue, which is missing. Install it (pip install"),
    ],
)
def test_a_cluster_that_is_not_there_is_told_and_nothing_is_written(
    cluster: Cluster, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_ANSWER", 1)
    with pytest.raises(CaseError) as caught, cluster.open(tmp_path / "out"):
        pass
    assert str(caught.value).startswith(f"--cluster: {told}")
    assert not (tmp_path / "out").exists()
