"""A policy search that waits for a robot: any policy, any optimizer that can wait, any robot that reads and writes tables.

Stability: stable.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchds import files
from torchds.errors import FileError, InvalidArgumentError, LastDigitsWarning, TorchdsError
from torchds.locks import one_writer
from torchds.optim.base import PolicySearch
from torchds.policy import GMRPolicy
from torchds.policy_file import versions
from torchds.sessions.books import BOOKS, Books
from torchds.sessions.given import STATE, refuse_used
from torchds.sessions.records import POLICY, History
from torchds.sessions.trial import TASK, Trial

RESULTS = "results.json"


class Session(Books):
    r"""A session in a folder: begun where there is none, else opened where it was left.

    Whoever opens it makes policy, optimizer and trial as they were made at the beginning; what they have learned since comes
    from the folder.

    Args:
        folder: of the session; it may be moved between commands.
        trial: what a roll-out is.
        policy: one, without a batch.
        optim: of `policy.parameters()`; made with elite "nominal", the first roll-out is the policy itself.
        n_updates: after which the session ends; it may be another one each time.
        schedulers: of torch, for `optim`; they step after each update.

    Attributes:
        history: what each update cost.
        best: the policy that cost least of those that were tried without noise, and what it cost; None before one has a
            finite cost.

    Raises:
        InvalidArgumentError: a batch of policies, an optimizer of other parameters, one that needs costs of each time step or
            does not try the policy itself first; or a folder that is used for something else.
        FileError: a session that was begun with another policy, another optimizer or another trial, or a damaged one.

    Example:
        >>> import tempfile, torch, torchds
        >>> eye = torch.eye(2, dtype=torch.float64)[None]
        >>> policy = torchds.GMRPolicy(torch.ones(1), torch.zeros(1, 2), eye, -eye, torch.zeros(1, 2))
        >>> noise = torchds.exploration.Gaussian(0.1)
        >>> optim = torchds.optim.PIBB(policy.parameters(), exploration=noise, n_rollouts=3, elite="nominal")
        >>> trial = torchds.sessions.Trial([1.0, 0.5], 100, 0.01, torchds.sessions.Layout(("x [m]", "y [m]")))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     session = torchds.sessions.Session(folder, trial, policy, optim)
        ...     update = session.ask().folder  # rollout-1.csv to rollout-3.csv, for the robot
        ...     _ = (update / "costs.csv").write_text("rollout,cost\n1,2.5\n2,1.5\n3,failed\n")
        ...     told = session.tell()
        >>> told.update, told.failed
        (1, 1)
    """

    def __init__(
        self,
        folder: str | Path,
        trial: Trial,
        policy: GMRPolicy,
        optim: PolicySearch,
        *,
        n_updates: int = 50,
        schedulers: Sequence[torch.optim.lr_scheduler.LRScheduler] = (),
    ) -> None:
        super().__init__(Path(folder), trial, policy, optim, n_updates)
        if policy.batch_shape:
            raise InvalidArgumentError(f"a session learns one policy, got a batch {policy.batch_shape}; take policy[i]")
        if {id(p) for p in optim.parameters} != {id(p) for p in policy.parameters()}:
            raise InvalidArgumentError("optim has to be made of policy.parameters(), all of them")
        if optim.costs_per_step or optim.elite != "nominal":
            raise InvalidArgumentError(
                f"a session needs a search that waits for whole roll-outs and tries the policy itself first; got "
                f"{type(optim).__name__} with elite={optim.elite!r}; make it with elite='nominal'"
            )
        self.schedulers = list(schedulers)
        self._history = History()
        asked = {name: part.cpu().clone() for name, part in trial.reference(policy)._asdict().items()}
        self._motion = [asked, list(trial.layout.reference), trial.dt]
        if (self.folder / STATE).is_file():
            self._open()
        else:
            refuse_used(self.folder, "its session.pt is missing; take another folder")
            files.make_folder(self.folder)
            with one_writer(self.folder):
                refuse_used(self.folder, self.hint("status"))  # by somebody else, since
                self.save()

    @property
    def history(self) -> History:
        """What each update cost, of the policy as it was tried before it."""
        return self._history

    def save(self) -> None:
        """Write results and policy, then the state: before that moment the command did not happen."""
        files.write_sealed(self.folder / RESULTS, {"versions": versions(), **asdict(self.history)})
        self.policy.save(self.folder / POLICY, dt=self.trial.dt)
        self._write(
            {
                "versions": versions(),
                "identity": self._motion,
                "policy": self.policy.state_dict(),
                "optim": self.optim.state_dict(),
                "schedulers": [plain(each.state_dict()) for each in self.schedulers],
                "history": asdict(self.history),
            }
        )

    def _open(self) -> None:
        path = self.folder / STATE
        state = files.load(path, "session")
        names = ("identity", "policy", "optim", "schedulers", "history", "best", *BOOKS)
        if missing := [name for name in names if name not in state]:
            raise FileError(f"{path} is no session of this version: no {', '.join(missing)} in it")
        check_motion(path, state["identity"], self._motion)
        try:
            self.policy.load_state_dict(state["policy"])
            self.optim.load_state_dict(state["optim"])
            for scheduler, given in zip(self.schedulers, state["schedulers"], strict=True):
                scheduler.load_state_dict(given)
            named = {TASK if name == "cost" else name: rows for name, rows in state["history"]["terms"].items()}
            self._history = History(**{**state["history"], "terms": named})  # "cost" in earlier versions
            self._read(state)
        except (KeyError, TypeError, ValueError, RuntimeError, TorchdsError) as error:
            raise FileError(f"{path} does not fit what is given now: {files.reason(error)}") from error

    def _step(self, closure: Callable[[], Tensor]) -> None:
        self.optim.step(closure)
        for scheduler in self.schedulers:
            scheduler.step()

    def _enter(self, terms: Mapping[str, Tensor], n_there: int) -> int:
        last = self.optim.last
        assert last is not None
        nominal = {name: float(values[0]) for name, values in terms.items()}
        self.history.add(self.spent, nominal, self.failed)
        self.history.seconds += n_there * self.trial.seconds
        return int(last.failed.sum())


def check_motion(path: Path, begun: Any, given: Any) -> None:
    """Refuse a session of another motion; one whose last digits differ goes on, and that is said.

    Args:
        path: of its state.
        begun: reference, columns and time step of its beginning; of earlier versions their digest.
        given: those of now.

    Raises:
        FileError: it was begun with another motion.
    """
    if files.digest(given) in (begun, files.digest(begun)):
        return
    if (
        isinstance(begun, str)
        or begun[1:] != given[1:]
        or not all(_alike(begun[0][name], given[0][name]) for name in given[0])
    ):
        earlier = "; or an earlier version of torchds began it on another processor: tell once where it was begun"
        raise FileError(
            f"{path} was begun with another motion: policy, start, time step or columns differ from those given now"
            f"{earlier if isinstance(begun, str) else ''}"
        )
    warnings.warn(
        f"{path} was begun on another processor or with other versions: it goes on, and last digits may differ",
        LastDigitsWarning,
        stacklevel=4,
    )


def _alike(x: Tensor, y: Tensor) -> bool:
    """Whether tensors differ by no more than a share of the largest number, 1e-6 of it in double precision."""
    if x.shape != y.shape or x.dtype != y.dtype:
        return False
    share = 1e-6 if y.dtype == torch.float64 else 1e-3
    size = max(y[y.isfinite()].abs().tolist(), default=0.0)
    return torch.allclose(x, y, rtol=0.0, atol=share * size, equal_nan=True)


def plain(state: Mapping[str, Any]) -> dict[str, Any]:
    """The state of a scheduler without functions, which it has from whoever made it."""
    return {name: value for name, value in state.items() if not callable(value) and not name.startswith("_get")}
