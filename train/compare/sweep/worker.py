"""A worker: it takes one job after the other until none is left, whoever else does the same."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

from torchds import files
from torchds.errors import TorchdsError
from torchds.files import make_folder
from train.compare.sweep.claims import Claim, Claims, Seen, Superseded
from train.compare.sweep.spec import Job
from train.folder import RESULTS, RunFolder
from train.learning.kept import learned, made
from train.learning.learner import Learner

POLL = 1.0  # s between two looks where others have all that is left
State = Literal["done", "failed", "open", "claimed"]


class Work(NamedTuple):
    """Something to be done once.

    Attributes:
        name: its own.
        finished: whether there is nothing more to do.
        do: does it, under a claim.
    """

    name: str
    finished: Callable[[], bool]
    do: Callable[[Claim], None]


def exhaust(claims: Claims, works: Sequence[Work]) -> None:
    """Do all of it that others do not do, and return when everything is finished."""
    left = list(works)
    while left:
        newest, idle = claims.newest(), True
        for work in left:
            seen = newest.get(work.name, Seen())
            if work.finished() or not claims.alone(work.name, seen):
                continue
            with claims.take(work.name, seen) as claim:
                if claim is not None and not work.finished():  # it may have been finished since
                    idle = False
                    work.do(claim)
        left = [work for work in left if not work.finished()]
        if left and idle:
            time.sleep(min(POLL, claims.beat))


class Runs:
    """The jobs of a sweep in their folder: `runs/NAME/` as `RunFolder`, `failed/NAME.json` why one failed, and `claims/`.

    Args:
        folder: of the sweep.
        jobs: all of them.
        claims: made by the workers.
        attempts: workers that may die over a job before it counts as failed.
    """

    def __init__(self, folder: Path, jobs: Sequence[Job], claims: Claims, attempts: int) -> None:
        self.folder, self.jobs, self.claims, self.attempts = folder, jobs, claims, attempts
        make_folder(folder / "failed")

    def works(self) -> list[Work]:
        """What there is to do."""
        return [Work(job.name, partial(self.finished, job), partial(self.do, job)) for job in self.jobs]

    def finished(self, job: Job) -> bool:
        """Whether there is nothing more to do for a job."""
        return self.state(job) in ("done", "failed")

    def state(self, job: Job, newest: Seen | None = None) -> State:
        """Where a job stands; whether it is claimed is known from its newest claim."""
        if self.home(job).has(RESULTS):
            return "done"
        if self.failure(job).is_file():
            return "failed"
        return "claimed" if newest is not None and newest.beat else "open"

    def home(self, job: Job) -> RunFolder:
        """The folder of a run."""
        return RunFolder(self.folder / "runs" / job.name)

    def failure(self, job: Job) -> Path:
        """The file that says why a job failed."""
        return self.folder / "failed" / f"{job.name}.json"

    def why(self, job: Job) -> str:
        """Why a job failed."""
        return str(files.read_sealed(self.failure(job))["error"])

    def retry(self) -> list[Job]:
        """Open all jobs that failed again; returns them."""
        failed = [job for job in self.jobs if self.state(job) == "failed"]
        for job in failed:
            self.claims.forgive(job.name)
            self.failure(job).unlink()
        return failed

    def do(self, job: Job, claim: Claim) -> None:
        """Make the run, from its checkpoint where there is one; what it raises is written down."""
        began, died = time.monotonic(), self.claims.newest()[job.name].died - 1
        if died >= self.attempts:
            return self.fail(job, f"{died} workers died over it, see claims/{job.name}.*", "")
        try:
            learner, home = Learner(job.options, made(job.options)), self.home(job)

            def watch(learner: Learner) -> None:
                claim.check()
                if learner.done == learner.n_updates:
                    home.save_policy(learner.policy, learner.task)

            learned(home, learner, watch)
        except Superseded:
            print(f"{job.name}: taken by another worker", flush=True)
        except Exception as error:
            said = str(error) if isinstance(error, TorchdsError) else f"{type(error).__name__}: {error}"
            self.fail(job, " ".join(said.split()), traceback.format_exc())
        else:
            print(f"{job.name}: done in {time.monotonic() - began:.1f} s", flush=True)

    def fail(self, job: Job, error: str, trace: str) -> None:
        """Write down why a job failed."""
        print(f"{job.name}: failed, {error}", flush=True)
        record: dict[str, Any] = {"job": job.name, "options": job.options.to_json(), "error": error, "traceback": trace}
        files.write_sealed(self.failure(job), record)
