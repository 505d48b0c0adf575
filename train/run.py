"""One learning run, or a batch of them, from the options to the folder that is left behind."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

import tasks
from torchds.errors import InvalidArgumentError
from torchds.optim import PolicySearch
from train import figures
from train.options import TASK_OPTIONS, RunOptions
from train.records import History, median, results, save_checkpoint, table, write_json
from train.searchers import make_closure, make_decay, make_optimizer
from train.searchers import n_updates as count_updates

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


def resume_options(folder: Path) -> RunOptions:
    """The options of the run in `folder`.

    Raises:
        InvalidArgumentError: no run is there.
    """
    if not (folder / OPTIONS).is_file():
        raise InvalidArgumentError(f"--resume {folder}: no {OPTIONS} there; give the folder of a run, below logs/")
    content = json.loads((folder / OPTIONS).read_text())
    return TASK_OPTIONS[content["task"]].from_json(content["options"])


def new_folder(options: RunOptions) -> Path:
    """Make LOGDIR/<task>/<optimizer>/<time>-<seed>/, a new one in any case."""
    parent = options.logdir / options.task / options.optimizer
    stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{options.seed}"
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
    task = tasks.make(options.task, **options.task_options())
    initial = task.policy()
    policy = initial.expand(options.runs)
    optim = make_optimizer(options, task, policy)
    decay = make_decay(options, task, optim)
    closure = make_closure(optim, task, policy)
    n_updates = count_updates(options, task)
    history = History()

    if folder is None:
        folder = new_folder(options)
        write_json(folder / OPTIONS, {"task": options.task, "options": options.to_json()})
    elif (folder / CHECKPOINT).is_file():
        saved = torch.load(folder / CHECKPOINT, weights_only=True)
        policy.load_state_dict(saved["policy"])
        optim.load_state_dict(saved["optimizer"])
        decay.load_state_dict(saved["decay"])
        history = History(**saved["history"])
    done = max(len(history.cost) - 1, 0)
    print(f"{options.task}: {options.runs} run(s), logs in {folder}")

    with SummaryWriter(str(folder), purge_step=done) as writer:
        if not history.cost:
            _, terms = evaluate(task, policy)
            history.add(0, terms, failed=0)
            log(writer, 0, history, optim, options, seconds=0.0)
        bar = tqdm(range(done, n_updates), initial=done, total=n_updates, unit="update", dynamic_ncols=True)
        try:
            for update in bar:
                began = time.perf_counter()
                optim.step(closure)
                decay.step()
                _, terms = evaluate(task, policy)
                failed = int(optim.last.failed.sum()) if optim.last else 0
                history.add(history.rollouts[-1] + optim.n_rollouts, terms, failed)
                seconds = time.perf_counter() - began
                history.seconds += seconds
                log(writer, update + 1, history, optim, options, seconds)
                content: dict[str, Any] = {"policy": policy, "optimizer": optim, "decay": decay}
                states = {name: thing.state_dict() for name, thing in content.items()}
                save_checkpoint(folder / CHECKPOINT, states | {"history": asdict(history)})
                bar.set_postfix_str(f"cost {median(history.cost[-1]):.4g}")
        except KeyboardInterrupt:
            raise Interrupted(f"stopped; continue with: python -m train {options.task} --resume {folder}") from None
        finally:
            bar.close()
        write_json(folder / RESULTS, results(options.task, options.to_json(), history))
        save_checkpoint(folder / "policy.pt", policy.state_dict())
        for name, figure in figures.of_run(task, initial, policy, history).items():
            figure.savefig(folder / f"{name}.png", dpi=130)
            writer.add_figure(name, figure, n_updates)
        hparams = {k: v for k, v in options.to_json().items() if isinstance(v, (int, float, str)) and k != "logdir"}
        writer.add_hparams(hparams, {"hparam/final_cost_median": median(history.cost[-1])}, run_name=".")
    print(table(history))
    print(f"{history.rollouts[-1]} roll-outs per run in {history.seconds:.1f} s; figures and results in {folder}")
    return folder


@torch.no_grad()
def evaluate(task: tasks.Task, policy: Any) -> Any:
    """A noise-free trial."""
    return task.evaluate(policy)


def log(
    writer: SummaryWriter, update: int, history: History, optim: PolicySearch, options: RunOptions, seconds: float
) -> None:
    """Write the scalars of one update; medians over runs, with quartiles for the total."""
    quantiles = np.quantile(history.cost[-1], [0.25, 0.5, 0.75])
    for name, value in zip(("cost/total_q1", "cost/total", "cost/total_q3"), quantiles, strict=True):
        writer.add_scalar(name, value, update)
    for name, values in history.terms.items():
        writer.add_scalar(f"cost/{name}", median(values[-1]), update)
    writer.add_scalar("rollouts/total", history.rollouts[-1], update)
    writer.add_scalar("rollouts/failed", history.failed[-1], update)
    writer.add_scalar("exploration/lr", optim.param_groups[0]["lr"], update)
    if optim.last is not None:
        w = optim.last.weights
        writer.add_scalar("weights/entropy", -(w * w.clamp_min(1e-300).log()).sum(0).mean(), update)
        writer.add_scalar("exploration/mean_cost", torch.where(optim.last.failed, 0, optim.last.cost).mean(), update)
        writer.add_scalar("time/update_seconds", seconds, update)
