"""One learning run, or a batch of them, from the options to the folder that is left behind."""

from __future__ import annotations

import json
import time
from pathlib import Path

import torch
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from torchds.errors import InvalidArgumentError
from train.folder import results, save_checkpoint, table, write_json
from train.learning import figures
from train.learning.album import Album
from train.learning.learner import Learner
from train.options import TASK_OPTIONS, RunOptions
from train.statistics import median, quartiles

CHECKPOINT = "checkpoint.pt"
OPTIONS = "options.json"
RESULTS = "results.json"


class Interrupted(Exception):
    """The run was stopped from the keyboard; its folder can be resumed."""


def check(options: RunOptions) -> None:
    """Refuse numbers that cannot be run, before anything is built.

    Raises:
        InvalidArgumentError: which option, what it is, and what is allowed.
    """
    for name in ("runs", "updates", "rollouts"):
        value = getattr(options, name)
        if value is not None and value < (0 if name == "updates" else 1):
            raise InvalidArgumentError(f"--{name} has to be at least {0 if name == 'updates' else 1}, got {value}")
    if not options.scale > 0 or not options.cost_noise >= 0:
        raise InvalidArgumentError(
            f"--scale has to be positive and --cost-noise at least 0, got {options.scale} and {options.cost_noise}"
        )


def resume_options(folder: Path) -> RunOptions:
    """The options of the run in `folder`.

    Raises:
        InvalidArgumentError: no run is there.
    """
    if not (folder / OPTIONS).is_file():
        raise InvalidArgumentError(f"--resume {folder}: no {OPTIONS} there; give the folder of a run, below logs/")
    content = json.loads((folder / OPTIONS).read_text())
    return TASK_OPTIONS[content["task"]].from_json(content["options"])


def new_folder(logdir: Path, task: str, optimizer: str, seed: int) -> Path:
    """Make LOGDIR/<task>/<optimizer>/<time>-<seed>/, a new one in any case."""
    parent = logdir / task / optimizer
    stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{seed}"
    names = (stem if i == 0 else f"{stem}.{i}" for i in range(1000))
    for folder in (parent / name for name in names):
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise InvalidArgumentError(f"cannot make a new folder like {parent / stem}")


def run(options: RunOptions) -> Path:
    """Learn, log, and return the folder of the run.

    Raises:
        InvalidArgumentError: options that do not fit.
        Interrupted: from the keyboard; everything up to the last update is kept.
    """
    folder = options.resume
    options = resume_options(folder) if folder is not None else options
    check(options)
    learner = Learner(options)
    if folder is None:
        folder = new_folder(options.logdir, options.task, options.optimizer, options.seed)
        write_json(folder / OPTIONS, {"task": options.task, "options": options.to_json()})
    elif (folder / CHECKPOINT).is_file():
        learner.load_state_dict(torch.load(folder / CHECKPOINT, weights_only=True))
    print(f"{options.task}: {options.runs} run(s), logs in {folder}")
    with SummaryWriter(str(folder), purge_step=learner.done) as writer:
        album = Album(writer, learner)
        if not learner.history.cost:
            learner.start()
            log(writer, learner, seconds=0.0)
            album.add()
        bar = tqdm(initial=learner.done, total=learner.n_updates, unit="update", dynamic_ncols=True)
        try:
            while learner.done < learner.n_updates:
                seconds = learner.update()
                log(writer, learner, seconds)
                album.add()
                save_checkpoint(folder / CHECKPOINT, learner.state_dict())
                bar.set_postfix_str(f"cost {median(learner.history.cost[-1]):.4g}", refresh=False)
                bar.update()
        except KeyboardInterrupt:
            raise Interrupted(f"stopped; continue with: python -m train {options.task} --resume {folder}") from None
        finally:
            bar.close()
        finish(folder, writer, learner)
        album.finish(folder)
    history = learner.history
    print(table(history))
    print(f"{history.rollouts[-1]} roll-outs per run in {history.seconds:.1f} s; figures and results in {folder}")
    return folder


def finish(folder: Path, writer: SummaryWriter, learner: Learner) -> None:
    """Write results, policies, figures and hyper-parameters."""
    options, history = learner.options, learner.history
    write_json(folder / RESULTS, results(options.task, options.to_json(), history))
    save_checkpoint(folder / "policy.pt", learner.policy.state_dict())
    for name, figure in figures.of_run(learner).items():
        figure.savefig(folder / f"{name}.png", dpi=130)
        writer.add_figure(name, figure, learner.n_updates)
    hparams = {k: v for k, v in options.to_json().items() if isinstance(v, (int, float, str)) and k != "logdir"}
    writer.add_hparams(hparams, {"hparam/final_cost_median": median(history.cost[-1])}, run_name=".")


def log(writer: SummaryWriter, learner: Learner, seconds: float) -> None:
    """Write the scalars of one update; medians over runs, with quartiles for the total."""
    history, update = learner.history, learner.done
    for name, value in zip(("cost/total_q1", "cost/total", "cost/total_q3"), quartiles(history.cost[-1]), strict=True):
        writer.add_scalar(name, value, update)
    for name, values in history.terms.items():
        writer.add_scalar(f"cost/{name}", median(values[-1]), update)
    if learner.path is not None:
        for tag, value in learner.task.diagnostics(learner.path).items():
            writer.add_scalar(tag, value.median(), update)
    writer.add_scalar("rollouts/total", history.rollouts[-1], update)
    writer.add_scalar("rollouts/failed", history.failed[-1], update)
    writer.add_scalar("rollouts/forward_equivalents", history.forward_equivalents[-1], update)
    for tag, value in learner.searcher.scalars().items():
        writer.add_scalar(tag, value, update)
    if update:
        writer.add_scalar("time/update_seconds", seconds, update)
