"""What `tell` asks about recordings of digging: that they are the motions asked for, and that their forces go with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from torch import Tensor

from torchds.sessions import questions
from torchds.sessions.questions import LARGE as LARGE
from torchds.sessions.questions import Finding
from torchds.sessions.questions import rms as rms
from train.hardware.robot_files import LAYOUT, Recorded


def question(
    numbers: Sequence[int], recorded: Recorded, asked: Tensor, stiffness: Tensor, dt: float, folder: Path | None = None
) -> list[Finding]:
    """What is to be said about the recordings of an update.

    Args:
        numbers: `[N]` of the roll-outs that were recorded.
        recorded: poses `(N, T+1, 3)` and forces `(N, T, 3)`.
        asked: `(N, T+1, 3)` poses of the references.
        stiffness: `(N, T)` of the references [N/m].
        dt: time step [s].
        folder: of the recordings, whose clocks are looked at; None to leave that.
    """
    found = questions.question(LAYOUT, numbers, recorded.pose, asked, dt)
    for i, k in enumerate(numbers):
        findings = forces(recorded.force[i], recorded.pose[i], asked[i], stiffness[i])
        found += [Finding(name, (k,), gross, words) for name, gross, words in findings]
    return found if folder is None else [*found, *questions.clocks(LAYOUT, numbers, folder)]


def forces(force: Tensor, pose: Tensor, asked: Tensor, stiffness: Tensor) -> Iterator[tuple[str, bool, str]]:
    """Whether measured forces `(T, 3)` go with the forces of a spring of that stiffness between the two motions."""
    spring = stiffness[:, None] * (asked - pose)[1:, :2]
    wanted, measured = (float(f.square().sum(-1).mean().sqrt()) for f in (spring, force))
    if measured > 0 and wanted > 1 and measured < wanted / 100:
        yield (
            "force",
            True,
            f"forces of {measured:.2g} N where the stiffness makes {wanted:.2g} N of the deviation: kN for N?",
        )
    elif measured > 1000:
        yield "force", True, f"forces of {measured:.2g} N on average: mN for N, or a sensor that was not zeroed?"
    along = float((spring * force[:, [0, 2]]).sum())
    if min(wanted, measured) > 5 and along < -0.5 * len(force) * wanted * measured:
        yield "sign", False, "forces against the deviation: their sign is that of the force on the arm?"
