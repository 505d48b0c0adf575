"""Commands that are interrupted at their writes: what is typed, and what has to stand there in the end.

Each is small: few updates, no pictures, and trials that cost little, so that hundreds of kills take minutes. Whoever gives the
command again types the same, or resumes the run that was begun.
"""

from types import SimpleNamespace

import torch
import tqdm
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import tasks.digging.task
from tasks.digging.simulation import Recording
from tests.faults import killer
from tests.motions import Short
from torchds import files
from train import __main__ as train_main
from train.compare import command as compare_command
from train.hardware.command import SessionOptions
from train.hardware.session import Session
from train.learning import kept
from train.learning import learner as learner_module
from train.learning import run as run_module
from train.options import options_for
from train.paper.measured import digging as experiment_module

torch.set_num_threads(1)
tqdm.tqdm.monitor_interval = 0  # no thread beside the one that is forked
run_module.SAVE_EVERY = kept.SAVE_EVERY = 0.0  # a checkpoint after every update: more places to be killed at
run_module.figures = SimpleNamespace(of_run=lambda learner: {}, uncounted=run_module.figures.uncounted)
run_module.Album = lambda events, learner: SimpleNamespace(
    learner=learner, add=lambda: None, finish=lambda folder: None
)
compare_command.report.write = lambda folder, rows, options, versions: ""
SHORT, make_task = Short(), learner_module.RunOptions.make_task
compare_command.made = lambda options: SHORT


fit_digging, FITTED = tasks.digging.task.LwrDigging.fit, []


def fitted_once(task, demonstrations):
    """The mixture of the recorded motions, which takes longer than all the rest."""
    if not FITTED:
        FITTED.append(fit_digging(task, demonstrations))
    return FITTED[0]


tasks.digging.task.LwrDigging.fit = fitted_once


def digest(value):
    """Of costs and policies, bit for bit."""
    return files.digest(value)


def results(path):
    """What has to be equal in results.json."""
    content = files.read_sealed(path)
    return digest([content[name] for name in ("rollouts", "cost", "terms", "failed", "forward_equivalents")])


def steps(folder):
    """The steps of each scalar in TensorBoard's files; none may be missing or twice."""
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    return {tag: [event.step for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


class run:
    """`python -m train via_point`, and `--resume` where it was begun."""

    @staticmethod
    def prepare(folder):
        folder.mkdir()

    @staticmethod
    def command(folder):
        options = options_for("via_point", runs=2, updates=4, rollouts=4, logdir=folder)
        begun = sorted(folder.rglob("options.json"))
        learner_module.RunOptions.make_task = lambda options: SHORT
        if begun:
            options.resume = begun[0].parent
        return train_main.ended(lambda: run_module.run(options))

    @staticmethod
    def outcome(folder):
        (path,) = folder.rglob("results.json")
        seen = steps(path.parent)
        return {
            "results": results(path),
            "policy": digest(files.load(path.with_name("policy.pt"), "policy")),
            "steps": seen,
            "contiguous": seen["cost/total"] == [0, 4, 8, 12, 16] or seen,
        }


class compare:
    """`python -m train compare`."""

    prepare = run.prepare

    @staticmethod
    def command(folder):
        small = {"optimizers": ("pibb", "cobyqa"), "coordinates": ("plain",), "updates": 3, "factors": (0.3, 1.0)}
        asked = compare_command.Compare(tasks=("via_point-N",), runs=2, tuning_runs=2, logdir=folder, **small)
        return train_main.ended(asked.main)

    @staticmethod
    def outcome(folder):
        runs = folder / "compare" / "runs"
        return {str(path.relative_to(runs)): results(path) for path in sorted(runs.rglob("results.json"))}


class session:
    """`python -m train hardware start`, `ask` and `tell`, with a robot that gives costs."""

    prepare = run.prepare

    @staticmethod
    def command(folder):
        learner_module.RunOptions.make_task = make_task
        return train_main.ended(lambda: session.type(folder / "s"))

    @staticmethod
    def type(folder):
        if not (folder / "session.pt").is_file():
            Session.start(folder, SessionOptions(seconds=1.0, rollouts=3, updates=2))
        while (mine := Session.open(folder)).done < 2:
            update = mine.ask().folder
            killer.Disk.paused = True
            (update / "costs.csv").write_text("rollout,cost\n1,1.5\n2,0.5\n3,1.0\n")
            killer.Disk.paused = False
            Session.open(folder).tell()

    @staticmethod
    def outcome(folder):
        found = {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*.csv"))}
        state = files.load(folder / "s" / "session.pt", "session")
        kept = digest({name: value for name, value in state.items() if name != "learner"})
        learned = state["learner"]
        return {**found, "state": kept, "learner": digest(learned), "results": results(folder / "s" / "results.json")}


def cheap_trial(task, reference, stiffness):
    """What `LwrDigging.execute` returns, made of the trial's number alone."""
    batch, T = stiffness.shape[:-1], stiffness.shape[-1]
    n = int(torch.tensor(batch).prod())
    generators = [torch.Generator().manual_seed(task.seed * 1000 + task.trials + i) for i in range(n)]
    task.trials += n
    force = torch.stack([torch.randn(T, 3, generator=g, dtype=torch.float64) for g in generators])
    none = torch.zeros(n, 0, dtype=torch.float64)
    done = Recording(
        reference.reshape(n, T + 1, 3),
        force,
        none,
        stiffness.reshape(n, T),
        force[:, :, 2].mean(-1),
        none,
        torch.zeros(n, dtype=torch.bool),
    )
    return Recording(*(value.reshape(batch + value.shape[1:]) for value in done))


class digging:
    """The digging experiment, with trials that are no simulation."""

    prepare = run.prepare

    @staticmethod
    def command(folder):
        kind, learner_module.RunOptions.make_task = tasks.digging.task.LwrDigging, make_task
        kind.execute = cheap_trial
        experiment_module.STARTS, experiment_module.UNIFORM, experiment_module.TRIALS = (150.0,), (100.0,), 2
        options = options_for("lwr_digging", grains="coarse", seconds=1.0, updates=2, rollouts=3, threads=1)
        return train_main.ended(experiment_module.Experiment(folder / "e", 0, options, runs=2).go_on)

    @staticmethod
    def outcome(folder):
        found = {str(path.relative_to(folder)): results(path) for path in sorted(folder.rglob("results.json"))}
        for path in sorted(folder.rglob("results.json")):
            found[f"steps of {path.parent.name}"] = steps(path.parent)
        return {**found, "trials": digest(files.read_sealed(folder / "e" / "trials.json")["trials"])}
