"""One learning run, or a batch of them, from the options to the folder that is left behind."""

from __future__ import annotations

from pathlib import Path

from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from tasks.loading import short
from torchds.errors import InvalidArgumentError
from train.folder import Interrupted, RunFolder
from train.learning import figures
from train.learning.album import Album
from train.learning.history import results, table
from train.learning.learner import Learner
from train.options import RunOptions
from train.statistics import median, quartiles


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


def run(options: RunOptions) -> Path:
    """Learn, log, and return the folder of the run.

    Raises:
        InvalidArgumentError: options that do not fit.
        Interrupted: from the keyboard; everything up to the last update is kept.
    """
    folder = None if options.resume is None else RunFolder(options.resume, "--resume")
    options = options if folder is None else folder.options()
    check(options)
    learner = Learner(options)
    if folder is None:
        folder = RunFolder.new(options.logdir, options.name, short(options.optimizer), options.seed)
        folder.begin(options.task, options.to_json())
    else:
        folder.restore(learner)
    print(f"{options.name}: {options.runs} run(s), logs in {folder.path}")
    with SummaryWriter(str(folder.path), purge_step=learner.done) as writer:
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
                folder.save_checkpoint(learner.state_dict())
                bar.set_postfix_str(f"cost {median(learner.history.cost[-1]):.4g}", refresh=False)
                bar.update()
        except KeyboardInterrupt:
            raise Interrupted(
                f"stopped; continue with: python -m train {options.task} --resume {folder.path}"
            ) from None
        finally:
            bar.close()
        finish(folder, writer, learner)
        album.finish(folder.path)
    history = learner.history
    print(table(history))
    print(f"{history.rollouts[-1]} roll-outs per run in {history.seconds:.1f} s; figures and results in {folder.path}")
    return folder.path


def finish(folder: RunFolder, writer: SummaryWriter, learner: Learner) -> None:
    """Write results, policies, figures and hyper-parameters."""
    options, history = learner.options, learner.history
    folder.write_results(results(options.task, options.to_json(), history))
    folder.save_policy(learner.policy.state_dict())
    for name, figure in figures.of_run(learner).items():
        figure.savefig(folder.path / f"{name}.png", dpi=130)
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
