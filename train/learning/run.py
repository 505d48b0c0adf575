"""One learning run, or a batch of them, from the options to the folder that is left behind."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from tasks import Task
from tasks.loading import short
from torchds import monitor, plotting
from torchds.errors import InvalidArgumentError
from torchds.monitor.events import Events
from train.folder import OPTIONS, RESULTS, Interrupted, RunFolder
from train.learning import figures
from train.learning.album import Album
from train.learning.history import History, results, table
from train.learning.learner import Learner
from train.learning.processes import Processes, Several, joined, restarts
from train.options import RunOptions, check_seed, usual_values
from train.searchers.named import runs_vary
from train.statistics import of_costs

SAVE_EVERY = 1.0  # s between two checkpoints; what is lost with a kill is computed again, bit for bit


def check(options: RunOptions) -> None:
    """Refuse numbers that cannot be run, before anything is built.

    Raises:
        InvalidArgumentError: which option, what it is, and what is allowed.
    """
    check_seed(options.seed)
    for name in ("runs", "updates", "rollouts"):
        value = getattr(options, name)
        if value is not None and value < (0 if name == "updates" else 1):
            raise InvalidArgumentError(f"--{name} has to be at least {0 if name == 'updates' else 1}, got {value}")
    if not options.scale > 0 or not options.cost_noise >= 0:
        raise InvalidArgumentError(
            f"--scale has to be positive and --cost-noise at least 0, got {options.scale} and {options.cost_noise}"
        )


def distinct(options: RunOptions, task: Task) -> RunOptions:
    """Options of as many runs as differ: where nothing is random, one stands for all.

    Args:
        options: of the runs.
        task: that they learn.
    """
    return options if runs_vary(options, task) else replace(options, runs=1)


def run(options: RunOptions, given: Collection[str] | None = None) -> Path:
    """Learn, log, and return the folder of the run; started by torchrun, together with the other processes.

    Args:
        options: of the run, or of one to resume.
        given: names of the options that were said beside `resume`; if None, those that are not as usual.

    Raises:
        InvalidArgumentError: options that do not fit.
        FileError: what is to be resumed is damaged or belongs to another run, or nothing can be written.
        ProcessLostError: another process has ended or hangs; everything up to the last checkpoint is kept.
        Interrupted: from the keyboard; the same holds.
    """
    with joined(options.patience) as processes:
        if isinstance(processes, Several) and processes.rank:
            return follow(processes, options)
        try:
            return lead(options, given, processes)
        finally:
            processes.tell(None)


def follow(processes: Several, options: RunOptions) -> Path:
    """Make the updates that the first process tells of, and write nothing."""
    try:
        if (said := processes.hear()) is not None:
            learner = Learner(type(options).from_json(said["options"]), wrap=processes.share)
            learner.load_state_dict(said["state"])
            processes.ready()
            while learner.done < learner.n_updates:
                learner.update()
    except KeyboardInterrupt:
        raise Interrupted(f"process {processes.rank} stopped") from None
    return options.logdir


def lead(options: RunOptions, given: Collection[str] | None, processes: Processes) -> Path:
    """Begin or continue the run, and write all that it leaves behind."""
    if options.folder is not None and options.resume is None and RunFolder(options.folder).has(OPTIONS):
        return resume(options, given, RunFolder(options.folder, "--folder"), processes)
    if options.resume is not None:
        return resume(options, given, RunFolder(options.resume, "--resume"), processes)
    check(options)
    if restarts() and options.folder is None:
        raise InvalidArgumentError(
            "torchrun --max-restarts needs --folder DIR or --resume DIR, so that a restart finds the run that was begun"
        )
    task, runs = options.make_task(), options.runs
    options = distinct(options, task)
    if options.runs < runs:
        print(f"{options.name}: nothing is random with --optimizer {options.optimizer}; one run stands for all {runs}")
    learner = Learner(options, task, wrap=processes.share)
    if options.folder is not None:
        folder = RunFolder(options.folder, "--folder")
    else:
        folder = RunFolder.new(options.logdir, options.name, short(options.optimizer), options.seed)
    with folder.alone():
        folder.begin(options.task, options.to_json())
        return learn(folder, learner, processes=processes)


def resume(options: RunOptions, given: Collection[str] | None, folder: RunFolder, processes: Processes) -> Path:
    """Continue the run in a folder."""
    folder.require(OPTIONS)
    with folder.alone():
        before = folder.options()
        if before.runs == 1 < options.runs and not runs_vary(before, replace(before, device="cpu").make_task()):
            options = replace(options, runs=1)  # where nothing is random, it stands for as many as were given
        options = merged(options, before, folder, given)
        check(options)
        learner = Learner(options, wrap=processes.share)
        written = folder.restore(learner)
        if learner.n_updates < learner.done:
            raise InvalidArgumentError(
                f"--updates {options.updates}: the run in {folder.path} has made {learner.done} already; give more, or none"
            )
        if options != before:
            folder.begin(options.task, options.to_json())
            print(
                f"{learner.done} updates are made, goes on to {learner.n_updates}; the noise keeps the decay that it was begun "
                f"with: {decay(learner)}"
            )
        return learn(folder, learner, written, processes)


def merged(options: RunOptions, before: RunOptions, folder: RunFolder, given: Collection[str] | None) -> RunOptions:
    """The options of a run to resume, extended by those that were given now.

    Raises:
        InvalidArgumentError: one contradicts what was begun.
    """
    if options.task != before.task:
        raise InvalidArgumentError(
            f"{folder.option} {folder.path} is a run of {before.task}, not of {options.task}; continue it with: "
            + resuming(before.task, folder)
        )
    usual, there, here = usual_values(options), before.to_json(), options.to_json()
    names = [name for name in here if name != "logdir"]
    if given is None:
        given = [name for name in names if here[name] != usual.get(name)]
    differing = [name for name in names if name in given and here[name] != there[name]]
    contradicting = [
        f"--{name.replace('_', '-')} {getattr(options, name)} (it was {getattr(before, name)})"
        for name in differing
        if name not in ("updates", "device", "threads")
    ]
    if contradicting:
        raise InvalidArgumentError(
            f"{folder.option} {folder.path} continues a run with its own options, and cannot take "
            f"{', '.join(contradicting)}; leave them out, or begin another run"
        )
    return replace(before, **{name: getattr(options, name) for name in differing})


def resuming(task: str, folder: RunFolder) -> str:
    """The command that goes on with a run."""
    return shlex.join(["python", "-m", "train", task, "--resume", str(folder.path)])


def decay(learner: Learner) -> str:
    """What the decay of the noise is, and where it stands, in words."""
    name = learner.options.decay or "that of the task"
    width = learner.searcher.scalars().get("exploration/lr")
    return name if width is None else f"{name}, its width is {width:.3g} times that of the start"


def learn(folder: RunFolder, learner: Learner, written: int = 0, processes: Processes | None = None) -> Path:
    """Make the updates that are missing, and write what a finished run has; one that is finished is left as it is.

    Args:
        folder: of the run, which nobody else writes to.
        learner: new, or as the checkpoint has it.
        written: bytes of TensorBoard's file that belong to the checkpoint.
        processes: that try their share of the roll-outs; None for this one alone.
    """
    processes = processes or Processes()
    options, history = learner.options, learner.history
    print(f"{options.name}: {options.runs} run(s), logs in {folder.path}")
    if folder.has(RESULTS) and len(folder.results()["cost"]) == learner.n_updates + 1 == learner.done + 1:
        print(f"all {learner.done} updates are made, nothing is changed")
        return folder.path
    with Events(folder.path, written) as events:
        album = Album(events, learner)
        if events.lost:
            print(f"note: {events.path} was cut or lost; it has the costs of all updates again", file=sys.stderr)
            events.charts()
            for update in range(len(history.cost)):
                events.scalars(of_history(history, update), history.rollouts[update])
        if not history.cost:
            learner.start()
            events.charts()
            log(events, learner, seconds=0.0)
            album.add()
        processes.tell({"options": options.to_json(), "state": learner.state_dict()})
        bar = tqdm(initial=learner.done, total=learner.n_updates, unit="update", dynamic_ncols=True)
        saved = -SAVE_EVERY
        try:
            while learner.done < learner.n_updates:
                seconds = learner.update()
                log(events, learner, seconds)
                album.add()
                if learner.done == learner.n_updates or time.monotonic() - saved >= SAVE_EVERY:
                    folder.save_checkpoint(learner, events.flush())
                    saved = time.monotonic()
                bar.set_postfix_str(f"cost {of_costs(learner.history.cost[-1])[1]:.4g}", refresh=False)
                bar.update()
        except KeyboardInterrupt:
            raise Interrupted(f"stopped; continue with: {resuming(options.task, folder)}") from None
        finally:
            bar.close()
        finish(folder, events, album)
    print(table(history))
    if (noise := learner.searcher.scalars().get("surrogate/noise")) is not None:
        share = noise / abs(of_costs(history.cost[0])[1])
        print(f"estimated noise in the cost of a trial: {noise:.3g}, {share:.1%} of the initial cost")
    print(f"{history.rollouts[-1]} roll-outs per run in {history.seconds:.1f} s; figures and results in {folder.path}")
    return folder.path


def finish(folder: RunFolder, events: Events, album: Album) -> None:
    """Write policies, figures, film and hyper-parameters, and the results last: then the run is finished."""
    learner = album.learner
    options, history = learner.options, learner.history
    folder.save_policy(learner.policy, learner.task)
    with figures.uncounted(learner.task):
        for name, figure in figures.of_run(learner).items():
            plotting.save(folder.path / f"{name}.png", figure)
            events.figure(name, figure, history.rollouts[-1])
        album.finish(folder.path)
    events.options(telling(options))
    events.flush()
    folder.write_results(results(options.task, options.to_json(), history))


def telling(options: RunOptions) -> dict[str, bool | int | float | str]:
    """What tells a run from others: what learns, the seed, and every option that is not as usual."""
    usual, always = usual_values(options), ("optimizer", "exploration", "seed")
    usual["logdir"] = str(options.logdir)  # runs in different places are alike
    values = {name: v for name, v in options.to_json().items() if name in always or v != usual.get(name)}
    return {"task": options.name} | {name: v if isinstance(v, float) else str(v) for name, v in values.items()}


def log(events: Events, learner: Learner, seconds: float) -> None:
    """Write the scalars of one update; medians over runs, with quartiles for the total."""
    scalars = of_history(learner.history, learner.done) | learner.searcher.scalars()
    if learner.path is not None:
        scalars |= {tag: float(value.median()) for tag, value in learner.task.diagnostics(learner.path).items()}
    if learner.done:
        scalars["time/update_seconds"] = seconds
    events.scalars(scalars, learner.history.rollouts[-1])


def of_history(history: History, update: int) -> dict[str, float]:
    """What the history says of an update."""
    return monitor.of_costs({name: values[update] for name, values in history.terms.items()}) | {
        "rollouts/updates": update,
        "rollouts/failed": history.failed[update],
        "rollouts/forward_equivalents": history.forward_equivalents[update],
    }
