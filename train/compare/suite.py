"""The tables of docs/choosing.md and docs/recommended.md, by one command: `python -m train compare --suite docs`."""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from tasks import ENVIRONMENTS, PROBLEMS, options_of
from tasks.transfer import TRANSFER
from torchds.errors import InvalidArgumentError
from train.compare.report import Outcome, by_problem, number
from train.deep_rl.command import DeepRL
from train.folder import RESULTS, versions, write_text
from train.options import Optimizer
from train.tables import markdown

Method = tuple[str, str]  # optimizer and coordinates
Environment = Literal["ViaPointN", "ViaPointP"]
PAPER: Method = ("pibb", "plain")
RECOMMENDED: Method = ("surrogate", "trajectory")

LETTERS = ("via_point-N", "via_point-P")
LEARNED = tuple(name for name in PROBLEMS if name != "lwr_digging")  # that has an experiment of its own
NOISES = (0.0, 0.1, 0.5)  # in the cost of each trial, of the initial cost


class Part(NamedTuple):
    """Rows of one table.

    Attributes:
        table: which.
        problems: what is learned.
        methods: by what.
        noise: in the cost of each trial.
        tuned: whether each method's first step is.
        environments: the same problems as PPO sees them.
    """

    table: str
    problems: Sequence[str]
    methods: Sequence[Method]
    noise: float = 0.0
    tuned: bool = False
    environments: Sequence[Environment] = ()


def parts() -> Iterator[Part]:
    """All of them."""
    yield Part("transfer", tuple(TRANSFER), (PAPER, RECOMMENDED))
    for noise in NOISES:
        yield Part("learners", LEARNED, (PAPER, RECOMMENDED), noise)
    others = (("pi2cma", "trajectory"), ("cma", "plain"), ("nes", "plain"), ("cobyqa", "plain"))
    for noise in NOISES[1:]:
        yield Part("noise", LETTERS, (PAPER, RECOMMENDED, *others), noise)
    every = [(name, kind) for name in get_args(Optimizer) for kind in ("plain", "trajectory")]
    yield Part("optimizers", LETTERS, every, tuned=True, environments=("ViaPointN", "ViaPointP"))


class Made(NamedTuple):
    """A part, and its rows in the order of its problems and methods."""

    part: Part
    rows: Sequence[Outcome]


def deep(logdir: Path, environment: Environment, updates: int | None, seed: int) -> Path:
    """The folder of three runs of PPO at the budget of the others, from this seed on, which are made if they are not there."""
    budget = options_of(ENVIRONMENTS[environment][0]).search.n_updates if updates is None else updates
    logdir = logdir / "compare" / "deep_rl" / f"{environment}-{budget}"
    finished = sorted(logdir.glob(f"*/*/*-{seed}/{RESULTS}"))
    return finished[-1].parent if finished else DeepRL(environment, seed=seed, updates=updates, logdir=logdir).main()


def end(row: Outcome) -> str:
    """The median cost at the end; why not, where there is none."""
    return "refused" if row.refused else number(row.quartiles()[1][-1])


def until(row: Outcome, level: float) -> str:
    """The end, and the roll-outs until the median was at `level`."""
    reached = None if row.refused else row.reaches(level)
    return end(row) + (f" ({reached})" if reached is not None else "")


def learners(made: Sequence[Made]) -> str:
    """PI^BB and the recommended learner, with their own steps."""
    lines = []
    for part, rows in made:
        for problem, (paper, ours) in by_problem(rows).items():
            median = paper.quartiles()[1]
            reached = ours.reaches(median[-1])
            lines.append(
                (
                    problem,
                    f"{part.noise:g}",
                    number(median[0]),
                    f"{end(paper)} after {paper.record['rollouts'][-1]}",
                    "never" if reached is None else str(reached),
                    end(ours),
                )
            )
    head = ("problem", "noise", "initial cost", "PI^BB", "recommended: roll-outs until then", "at the end")
    return markdown(head, lines)


def beside(made: Sequence[Made]) -> str:
    """All methods in lines, problems (and noise, where it differs) in columns."""
    noises = {part.noise for part, _ in made}
    columns, labels = {}, dict.fromkeys(row.label for _, rows in made for row in rows)
    for part, rows in made:
        for problem, members in by_problem(rows).items():
            level = next(row.quartiles()[1][-1] for row in members if row.label == PAPER[0])
            name = problem if len(noises) == 1 else f"{problem}, noise {part.noise:g}"
            columns[name] = {row.label: until(row, level) for row in members}
    lines = [(label, *(cells.get(label, "") for cells in columns.values())) for label in labels]
    return markdown(("final median cost (roll-outs to PI^BB's)", *columns), lines)


TABLES: dict[str, Callable[[Sequence[Made]], str]] = {
    "transfer": learners,
    "learners": learners,
    "noise": beside,
    "optimizers": beside,
}


def tables(made: Sequence[Made], command: str) -> dict[str, str]:
    """Each table by name, with the command, the versions and the time that it took below it."""
    used = versions()
    said = ", ".join(f"{name} {used[name]}" for name in ("torchds", "torch", "numpy"))
    found = {}
    for name, write in TABLES.items():
        mine = [one for one in made if one.part.table == name]
        minutes = sum(row.record.get("seconds", 0.0) for one in mine for row in one.rows) / 60
        by = f"*`{command}`, {datetime.date.today()}, {said}; {minutes:.0f} minutes of learning.*"
        found[name] = f"{write(mine)}\n\n{by}"
    return found


def keep(folder: Path, found: Mapping[str, str]) -> None:
    """Put tables into the pages of a folder, between the marks <!-- suite: NAME --> and <!-- suite end -->.

    Raises:
        InvalidArgumentError: no page has a place for one of them; then nothing is written.
    """
    pages = {path: path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.md"))}
    for name, table in found.items():
        place = re.compile(rf"(<!-- suite: {name} -->\n).*?(<!-- suite end -->)", re.DOTALL)
        homes = [path for path, text in pages.items() if place.search(text)]
        if not homes:
            raise InvalidArgumentError(
                f"--keep {folder}: no page there has <!-- suite: {name} --> ... <!-- suite end -->"
            )
        for path in homes:
            pages[path] = place.sub(lambda found: f"{found[1]}\n{table}\n\n{found[2]}", pages[path])  # noqa: B023
    for path, text in pages.items():
        write_text(path, text)
