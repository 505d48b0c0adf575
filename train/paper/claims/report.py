"""The claims as a table: CSV, Markdown and lines for the terminal, all from the same rows."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from train import tables
from train.folder import versions
from train.paper.claims.base import ALPHA, HELD, IN_PART, MEDIUM, NOT_HELD, NOT_MEASURED, Check, Claim, verdict

COLUMNS = ("id", "where", "says", "rule", "verdict", "check", "holds", "n", "delta", "p", "command")
HEADER = ("claim", "where", "what the paper says; what it takes to hold", "measured", "verdict")
SMALLEST = 7  # pairs with which a sign test can reach ALPHA
MARKS = {True: "+", False: "−"}


class Judged(NamedTuple):
    """A claim with what was measured for it, and how to measure it again."""

    claim: Claim
    checks: list[Check]
    command: str


def rows_of(row: Judged) -> list[dict[str, str]]:
    """One record per check, or one that says that there is none."""
    claim = row.claim
    common = {"id": claim.id, "where": claim.where, "says": claim.says, "rule": claim.rule, "command": row.command}
    common["verdict"] = verdict(row.checks)
    if not row.checks:
        return [common]
    return [
        {
            **common,
            "check": check.what,
            "holds": "yes" if check.holds else "no",
            "n": str(check.n),
            "delta": "" if check.effect is None else f"{check.effect:+.2f}",
            "p": "" if check.p is None else f"{check.p:.1e}",
        }
        for check in row.checks
    ]


def write_csv(path: Path, rows: Sequence[Judged]) -> None:
    """One line per check."""
    tables.write_csv(
        path, COLUMNS, [[cells.get(name, "") for name in COLUMNS] for row in rows for cells in rows_of(row)]
    )


def statistics(check: Check) -> str:
    """δ and p of a check, if it has them."""
    parts = ([] if check.effect is None else [f"δ = {check.effect:+.2f}"]) + (
        [] if check.p is None else [f"p = {check.p:.1e}"]
    )
    return ", ".join(parts)


def line(check: Check) -> str:
    """A check in one line."""
    return f"{MARKS[check.holds]} {check.what}" + (f"; {statistics(check)}" if check.p is not None else "")


def tally(rows: Sequence[Judged]) -> str:
    """How many claims held."""
    counts = Counter(verdict(row.checks) for row in rows)
    return ", ".join(f"{counts[name]} {name}" for name in (HELD, IN_PART, NOT_HELD, NOT_MEASURED) if counts[name])


def caution(runs: int) -> str:
    """What to say of too few runs."""
    if runs >= SMALLEST:
        return ""
    return f" With {runs} runs no sign test can reach p < {ALPHA:g}, it takes {SMALLEST}: this is a trial."


def terminal(rows: Sequence[Judged], runs: int) -> str:
    """Verdict and claim, each with its checks below."""
    width = max(len(row.claim.id) for row in rows)
    lines = []
    for row in rows:
        lines.append(f"{verdict(row.checks):<17} {row.claim.id:<{width}}  {row.claim.where}")
        lines += [f"    {line(check)}" for check in row.checks] or [f"    measure it with: {row.command}"]
    return "\n".join([*lines, f"{tally(rows)}.{caution(runs)}"])


def page(rows: Sequence[Judged], runs: int, command: str) -> str:
    """The page."""
    n_tests = sum(check.p is not None for row in rows for check in row.checks)
    table = []
    for row in rows:
        measured = "<br>".join(line(check) for check in row.checks) or f"measure it with `{row.command}`"
        text = f"{row.claim.says} *{row.claim.rule}*"
        table.append((f"`{row.claim.id}`", row.claim.where, text, measured, f"**{verdict(row.checks)}**"))
    software = ", ".join(f"{name} {value}" for name, value in versions().items())
    return (
        f"# The claims of the paper\n\nWhat Rey et al. (2018) say about their method, and what was measured here: "
        f"{tally(rows)}.\n\nMade by `{command}` on {time.strftime('%Y-%m-%d')} with {software}. One row again: "
        "`python -m train claims --only CLAIM`, with the same --runs and --seed.\n\n"
        "## How to read it\n\n"
        f"Samples are {runs} learning runs of different exploration noise, measured without noise; medians [quartiles]. A "
        f"comparison holds if its one-sided test gives p < {ALPHA:g} and Cliff's δ is at least medium (|δ| ≥ {MEDIUM:g}): "
        "independent samples by Mann-Whitney, before against after (→) by a sign test over runs, with δ over pairs. A number "
        "holds within the bounds beside it; cases that can be counted hold if all do, unless said. A claim is held if all of "
        f"its checks (+) hold, held in part if some do, and not held if none does. There are {n_tests} tests on this page, and "
        f"p is not corrected for that.{caution(runs)} The tasks fill in what the paper leaves out: geometry, via-points and "
        "demonstrations are our own. The digging rows are of a simulated robot: of uniform stiffness each trial is a "
        "sample, of what was learned each run, by the mean of five trials on beds that it has not met.\n\n"
        "## Claims\n\n" + tables.markdown(HEADER, table) + "\n"
    )
