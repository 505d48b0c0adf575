"""Callbacks for loops of your own.

Stability: stable.
"""

from __future__ import annotations

import warnings
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torchds.errors import FileError, InvalidArgumentError
from torchds.files import make_folder
from torchds.monitor.scalars import of_costs, of_search

if TYPE_CHECKING:
    from torchds.monitor.events import Events

Evaluate = Callable[[Any], "Tensor | Mapping[str, Tensor]"]
"""What the policy without noise costs: `(*batch,)`, or named terms of that shape."""


class Callback:
    """Hands what a search says to a function, after each update.

    Args:
        report: `report(scalars, step)` with the numbers by name and the roll-outs spent so far; `log` of a run of Weights &
            Biases and `log_metrics` of MLflow are such functions.
        evaluate: `evaluate(policy)` tries the policy without noise and returns its cost, `(*batch,)` with one for each run of a
            batch, or named terms; without it there are the costs of the roll-outs that the search tried.

    Example:
        >>> import torchds
        >>> theta = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
        >>> optim = torchds.optim.PIBB([theta], exploration=torchds.exploration.Gaussian(0.3), n_rollouts=20)
        >>> seen = {}
        >>> callback = Callback(lambda scalars, step: seen.update({step: scalars["cost/tried"]}))
        >>> for update in range(1, 4):
        ...     _ = optim.step(lambda: (theta - 1).square().sum(-1))
        ...     callback(optim, theta, update)
        >>> list(seen)
        [20, 40, 60]
    """

    def __init__(self, report: Callable[[dict[str, float], int], Any], evaluate: Evaluate | None = None) -> None:
        self.report, self.evaluate = report, evaluate

    @torch.no_grad()
    def __call__(self, optim: torch.optim.Optimizer, policy: Any, update: int) -> None:
        """Report.

        Args:
            optim: that searches.
            policy: what it has learned by now; handed to `evaluate` as it is.
            update: how many were made, 0 before the first.

        Raises:
            InvalidArgumentError: `update` is negative.
        """
        if update < 0:
            raise InvalidArgumentError(f"update has to be the number of updates made so far, at least 0, got {update}")
        step = update * rollouts(optim)
        scalars = of_search(optim) | {"rollouts/updates": float(update)}
        if self.evaluate is not None:
            costs = self.evaluate(policy)
            scalars |= of_costs(costs if isinstance(costs, Mapping) else {"total": costs})
        self.report(scalars, step)


class TensorBoard:
    """Writes what TensorBoard shows of a search: scalars against roll-outs, medians with their bands, and the motion.

    The file is there with the first call, and complete after each. `state_dict` belongs into the checkpoint of the search: what
    came after it is cut off by `load_state_dict`, and every update stands there once.

    Args:
        logdir: the folder of this run, made where it is missing.
        evaluate: as for `Callback`.
        motion: `motion(policy)` returns positions, `(*batch, T+1, D)` with D ≥ 2, to draw beside those of the first call.
        every: updates from one picture to the next.
        options: what differs between your runs, by name, for the page HParams.

    Raises:
        MissingPackageError: TensorBoard is not installed, or matplotlib where motions are to be drawn.
        InvalidArgumentError: `every` is no positive number.

    Example:
        >>> import tempfile, torchds
        >>> theta = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
        >>> optim = torchds.optim.PIBB([theta], exploration=torchds.exploration.Gaussian(0.3), n_rollouts=20)
        >>> with tempfile.TemporaryDirectory() as logdir:
        ...     board = TensorBoard(f"{logdir}/first")
        ...     for update in range(1, 4):
        ...         _ = optim.step(lambda: (theta - 1).square().sum(-1))
        ...         board(optim, theta, update)
    """

    def __init__(
        self,
        logdir: str | Path,
        evaluate: Evaluate | None = None,
        *,
        motion: Callable[[Any], Tensor] | None = None,
        every: int = 10,
        options: Mapping[str, bool | int | float | str] | None = None,
    ) -> None:
        from torchds.monitor import events

        if motion is not None:
            from torchds import plotting as plotting  # says now what is missing
        if every < 1:
            raise InvalidArgumentError(f"every has to be a number of updates, at least 1, got {every}")
        self.logdir, self.motion, self.every, self.options = Path(logdir), motion, every, dict(options or {})
        self._log = Callback(self._write, evaluate)
        self._path, self._make = self.logdir / events.NAME, events.Events
        self._events: Events | None = None
        self._first: Tensor | None = None

    def __call__(self, optim: torch.optim.Optimizer, policy: Any, update: int) -> None:
        """Write scalars, and where it is time a picture; arguments as for `Callback`.

        Raises:
            FileError: the file cannot be written, or belongs to an earlier run.
        """
        self._log(optim, policy, update)
        events = self._begun()
        if self.motion is not None and (self._first is None or update % self.every == 0):
            self._draw(events, self.motion(policy), update * rollouts(optim))
        events.write()

    def state_dict(self) -> dict[str, Any]:
        """What belongs into a checkpoint: how long the file is, and the motion that is drawn beside all others."""
        return {"length": self._begun().flush(), "first": self._first}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on in a folder where `state_dict` was taken, before the first call.

        Where the file has gone or is shorter than it was then, a new one begins, and a UserWarning says so.

        Raises:
            FileError: the file cannot be written.
        """
        self._first = state["first"]
        self._open(int(state["length"]))

    def _begun(self) -> Events:
        """The file, which is begun where there is none yet."""
        if self._events is None:
            if self._path.exists():
                raise FileError(
                    f"{self._path} is there already; give each run a folder of its own, or continue that one: "
                    "load_state_dict of what state_dict returned"
                )
            return self._open(0)
        return self._events

    def _open(self, length: int) -> Events:
        make_folder(self.logdir)
        self._events = events = self._make(self.logdir, length)
        weakref.finalize(self, events.close)
        if events.lost:
            warnings.warn(f"{self._path} was cut or lost; it has the updates from here on alone", stacklevel=3)
        if events.lost or not length:
            events.charts()
            if self.options:
                events.options(self.options)
        return events

    def _write(self, scalars: dict[str, float], step: int) -> None:
        self._begun().scalars(scalars, step)

    def _draw(self, events: Events, x: Tensor, step: int) -> None:
        """The motion now, in front of the first one."""
        from torchds import plotting

        x = x.detach().cpu()
        self._first = x if self._first is None else self._first
        figure, axes = plotting.small_map(self._first, x)
        plotting.trajectories(axes, self._first[..., :2], color=plotting.BEFORE, label="in the beginning", lw=1.4)
        plotting.trajectories(axes, x[..., :2], color=plotting.AFTER, label="now", lw=1.4)
        plotting.finish_map(axes, f"After {step} roll-outs")
        events.figure("motion", figure, step)


def rollouts(optim: torch.optim.Optimizer) -> int:
    """Trials of one update: N of a policy search, one of an optimizer that follows a gradient."""
    return int(getattr(optim, "n_rollouts", 1))
