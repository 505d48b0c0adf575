"""Many runs as independent jobs on one folder: `python -m train sweep SPEC.toml`."""

from __future__ import annotations

import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import threadpoolctl
import torch
import tyro

from torchds import files
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError
from train.compare import report
from train.compare.sweep import spec
from train.compare.sweep.claims import Claim, Claims, Seen
from train.compare.sweep.table import rows
from train.compare.sweep.worker import Runs, Work, exhaust
from train.folder import Interrupted, versions
from train.tables import aligned

MADE_OF = "made_of.json"


@dataclass
class Sweep:
    """Work on all jobs of a sweep until none is left, beside any number of others who do the same on the same folder.

    A worker that is killed loses nothing: another one goes on from the job's checkpoint. The last one writes the report. A file
    of yours that was edited, or what it imports from beside it, is another job; after a change of a module give another
    --logdir.
    """

    spec: Annotated[Path, tyro.conf.Positional]
    """The sweep in TOML: each key is an option of the training commands, lists are multiplied. docs/scale.md has examples."""
    action: Annotated[Literal["work", "status", "retry"], tyro.conf.Positional] = "work"
    """work: do what is left. status: say where every job stands. retry: open the jobs that failed again."""
    beat: float = 10.0
    """Seconds between two signs of life of a worker."""
    patience: float = 60.0
    """Seconds without one after which another worker takes the job."""
    attempts: int = 10
    """Workers that may die over a job before it counts as failed."""
    submit: int = 0
    """Workers to hand to a cluster instead of working here; needs the extra cluster (submitit)."""
    cluster: Literal["slurm", "local"] = "slurm"
    """Where to submit them: SLURM, or processes on this machine."""
    minutes: int = 24 * 60
    """Time limit of a submitted worker; what it leaves is gone on with by others."""
    partition: str | None = None
    """Of SLURM."""
    logdir: Path = field(default_factory=lambda: Path("logs"))
    """Where to write: LOGDIR/sweep/<name of the spec>/."""

    @property
    def folder(self) -> Path:
        """That of the sweep, which all workers see."""
        return self.logdir / "sweep" / self.spec.stem

    def main(self) -> Path:
        """Do what the action says; returns the folder of the sweep.

        Raises:
            InvalidArgumentError: numbers out of range, or a job that cannot be.
            FileError: the spec cannot be read, or the folder not be written to.
            MissingPackageError: submitit is not installed.
            Interrupted: from the keyboard; the same command continues.
        """
        if not 0 < self.beat < self.patience or self.attempts < 1 or self.submit < 0 or self.minutes < 1:
            raise InvalidArgumentError(
                "0 < --beat < --patience, --attempts ≥ 1, --submit ≥ 0 and --minutes ≥ 1 are needed, got "
                f"{self.beat}, {self.patience}, {self.attempts}, {self.submit} and {self.minutes}"
            )
        jobs = spec.read(self.spec)
        if self.submit and self.action == "work":
            return self.submitted()
        runs = Runs(self.folder, jobs, Claims(self.folder / "claims", self.beat, self.patience), self.attempts)
        actions: dict[str, Callable[[Runs], None]] = {"work": self.work, "status": self.status, "retry": self.retry}
        actions[self.action](runs)
        return self.folder

    def work(self, runs: Runs) -> None:
        """Do what is left of the jobs, and the report."""
        print(f"{len(runs.jobs)} jobs in {self.folder}", flush=True)
        try:
            exhaust(runs.claims, runs.works())
            exhaust(runs.claims, [self.report(runs)])
        except KeyboardInterrupt:
            raise Interrupted("stopped; the same command continues") from None
        failed = sum(runs.state(job) == "failed" for job in runs.jobs)
        print(f"{len(runs.jobs) - failed} jobs done, {failed} failed; {self.folder / 'report' / 'report.md'}")

    def report(self, runs: Runs) -> Work:
        """Table and figures of all jobs, once for what is done and what failed."""
        states = {job.name: runs.state(job) for job in runs.jobs}
        digest = hashlib.sha256(json.dumps(states, sort_keys=True).encode()).hexdigest()[:16]
        folder = self.folder / "report"

        def finished() -> bool:
            try:
                return files.read_sealed(folder / MADE_OF)["digest of jobs"] == digest
            except FileError:
                return False

        def write(claim: Claim) -> None:
            records = {job.name: runs.home(job).results() for job in runs.jobs if states[job.name] == "done"}
            failures = {job.name: runs.why(job) for job in runs.jobs if states[job.name] == "failed"}
            files.make_folder(folder)
            text = report.write(folder, rows(runs.jobs, records, failures), self.said(), versions())
            files.write_sealed(folder / MADE_OF, {"digest of jobs": digest, "jobs": states})
            print(text, flush=True)

        return Work(f"report-{digest}", finished, write)

    def said(self) -> dict[str, Any]:
        """What the report is said to be made by."""
        return {"sweep": self.spec.name, **files.plain({"jobs": self.spec.read_text(encoding="utf-8").strip()})}

    def status(self, runs: Runs) -> None:
        """Say how many jobs are where, who works, and why some failed."""
        newest = runs.claims.newest()
        states = {job.name: runs.state(job, newest.get(job.name)) for job in runs.jobs}
        print(", ".join(f"{n} {state}" for state, n in Counter(states.values()).most_common()))
        lines = []
        for job in runs.jobs:
            if states[job.name] == "claimed":
                seen = newest.get(job.name, Seen())
                who = runs.claims.path(job.name, seen.number).read_text(encoding="utf-8").strip()
                lines.append((job.name, f"{who}, last sign of life {time.time() - seen.beat / 1e9:.0f} s ago"))
            elif states[job.name] == "failed":
                lines.append((job.name, f"failed: {runs.why(job)}"))
        if lines:
            print(aligned(("job", ""), lines))

    def retry(self, runs: Runs) -> None:
        """Open failed jobs again; the next worker takes them."""
        opened = runs.retry()
        print(f"{len(opened)} jobs are open again" + (f"; python -m train sweep {self.spec}" if opened else ""))

    def submitted(self) -> Path:
        """Hand workers to a cluster; on this machine, wait for them.

        Raises:
            MissingPackageError: submitit is not installed.
        """
        try:
            import submitit
        except ImportError as error:
            raise MissingPackageError("submitit", "cluster", "sweep --submit") from error
        executor = submitit.AutoExecutor(folder=self.folder / "submitit", cluster=self.cluster)
        executor.update_parameters(name=f"torchds-{self.spec.stem}", timeout_min=self.minutes, cpus_per_task=1)
        if self.partition is not None:
            executor.update_parameters(slurm_partition=self.partition)
        worker = replace(self, submit=0, spec=self.spec.absolute(), logdir=self.logdir.absolute())
        handed = [executor.submit(one_thread, worker) for _ in range(self.submit)]
        print(f"workers {', '.join(job.job_id for job in handed)}; what they say is in {self.folder / 'submitit'}")
        if self.cluster != "slurm":
            for job in handed:
                job.result()
        return self.folder


def one_thread(worker: Sweep) -> None:
    """What a submitted process does."""
    torch.set_num_threads(1)
    with threadpoolctl.threadpool_limits(1):
        worker.main()
