"""What a roll-out of a session is: the motion that is asked for, and what a recording of it costs.

Stability: stable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from torchds.arrays import Array, check_positive, tensor
from torchds.errors import InvalidArgumentError
from torchds.policy import GMRPolicy
from torchds.rollouts import Rollout, rollout
from torchds.sessions.layout import Layout
from torchds.sessions.questions import Finding, question
from torchds.sessions.tables import Recorded
from torchds.stops import StopCondition


class Reference(NamedTuple):
    """What a robot is asked for.

    Attributes:
        x: `(*batch, T+1, C)` positions.
        v: `(*batch, T, C)` velocities.
        stiffness: `(*batch, T, Q)`.
    """

    x: Tensor
    v: Tensor
    stiffness: Tensor


class Measured(NamedTuple):
    """What the plant of a recorded roll-out is, for cost terms.

    Attributes:
        x: `(*batch, T+1, C)` positions.
        v: `(*batch, T, C)` velocities, by differences.
        stiffness: `(*batch, T, Q)` that was asked for.
        measured: `(*batch, T, M)` everything else that was recorded, in the order of the layout.
    """

    x: Tensor
    v: Tensor
    stiffness: Tensor
    measured: Tensor


TASK = "task"
"""The cost term of whoever gives one cost."""

TAKEN = ("rollout", "control", "cost", "weight", "state", "measured")
"""What a session calls its own columns and terms."""

Terms = Callable[[Rollout], Mapping[str, Tensor] | Tensor]


class Trial:
    """One motion of the policy from one start.

    Args:
        x0: `(D,)` where it begins, or `(C,)` with what the policy does not see; the robot has to stand there.
        n_steps: T.
        dt: time step [s].
        layout: of the files; it has a position for each output of the policy, the first D of them its inputs.
        cost_terms: of a roll-out `(*batch, T+1, C)` whose `x` and `v` are measured and whose `plant` is a `Measured`: terms by
            name, none of `TAKEN`, or one cost `(*batch)`, which is the term "task". None where costs are given in `costs.csv`.
        reaches: `(..., C)` positions to truths, whether the robot can be there; what leaves that is never asked for.
        stop: where a roll-out would end early (`torchds.Walls`, `torchds.Bounds`); what goes there is never asked for either.

    Raises:
        InvalidArgumentError: sizes that do not agree, or a step or number that is not positive.
    """

    def __init__(
        self,
        x0: Array,
        n_steps: int,
        dt: float,
        layout: Layout,
        cost_terms: Terms | None = None,
        *,
        reaches: Callable[[Tensor], Tensor] | None = None,
        stop: StopCondition | None = None,
    ) -> None:
        self.x0 = tensor("x0", x0)
        if self.x0.ndim != 1 or len(self.x0) > len(layout.position):
            raise InvalidArgumentError(
                f"x0 has to be one start with at most the {len(layout.position)} positions of the layout, got shape "
                f"{tuple(self.x0.shape)}; tasks of several starts are several sessions"
            )
        check_positive("dt", dt)
        if n_steps < 1:
            raise InvalidArgumentError(f"n_steps has to be at least 1, got {n_steps}")
        self.n_steps, self.dt, self.cost_terms, self.reaches = int(n_steps), float(dt), cost_terms, reaches
        self.layout, self.stop = layout, stop

    @classmethod
    def of(cls, task: Any, layout: Layout | None = None, **options: Any) -> Self:
        """The trial of a task (`tasks.Task`): its motion, its cost terms, and the names and units of its demonstrations.

        Args:
            task: an object with `motion()`, `cost_terms(path)`, `demonstrations`, and `stop` or none.
            layout: in place of that of the demonstrations.
            **options: see `Trial`.
        """
        x0, n_steps, dt = task.motion()
        layout = Layout.of(task.demonstrations) if layout is None else layout
        return cls(x0, n_steps, dt, layout, task.cost_terms, **{"stop": getattr(task, "stop", None), **options})

    @property
    def seconds(self) -> float:
        """How long a roll-out takes."""
        return self.n_steps * self.dt

    def reference(self, policy: GMRPolicy) -> Reference:
        """What the policies ask for; what they visit is reported.

        Raises:
            InvalidArgumentError: a policy of other sizes than the start and the layout, or one that makes its roll-outs itself.
        """
        return self._asked(policy)[1]

    def _asked(self, policy: GMRPolicy) -> tuple[Rollout, Reference]:
        D, C, Q = policy.input_dim, policy.output_dim, policy.stiffness_dim
        if hasattr(policy, "rollout"):
            raise InvalidArgumentError(
                f"a session asks for `torchds.rollout` of a policy, got a {type(policy).__name__}, which makes its roll-outs "
                "itself; overwrite `Trial.reference` and `Trial.terms`, or take a GMRPolicy"
            )
        found = (len(self.layout.position), len(self.layout.stiffness))
        if found != (C, Q):
            raise InvalidArgumentError(
                f"the layout has to have {C} positions and {Q} columns of stiffness, as the "
                f"policy does, got {found[0]} and {found[1]}"
            )
        if len(self.x0) not in (D, C):
            raise InvalidArgumentError(
                f"x0 has to have the {D} inputs of the policy, or all {C} positions, got {len(self.x0)} numbers"
            )
        with torch.no_grad():
            path = rollout(policy, self.x0[:D], self.n_steps, self.dt)
        turned = torch.nn.functional.pad(path.v[..., D:].cumsum(-2) * self.dt, (0, 0, 1, 0))
        rest = turned + self.x0.new_zeros(C - D) if len(self.x0) == D else turned + self.x0[D:]
        stiffness = path.stiffness if path.stiffness is not None else path.v[..., :0]
        return path, Reference(torch.cat([path.x, rest], -1), path.v, stiffness)

    def possible(self, asked: Reference) -> Tensor:
        """`(*batch)` whether a robot may be asked for these motions."""
        fine = asked.x.isfinite().flatten(-2).all(-1) & asked.stiffness.isfinite().flatten(-2).all(-1)
        if self.reaches is not None:
            fine = fine & self.reaches(asked.x).all(-1)
        return fine if self.stop is None else fine & ~self.stop(asked.x[..., :-1, :], asked.x[..., 1:, :]).any(-1)

    def terms(self, policy: GMRPolicy, recorded: Recorded, there: Tensor) -> dict[str, Tensor]:
        """Cost terms `(N, *batch)` of recordings; infinite where there is none.

        Args:
            policy: `(N, *batch)`, with the noise of the roll-outs.
            recorded: N in front.
            there: `(N,)` whether a roll-out was recorded.

        Raises:
            InvalidArgumentError: nobody said what a recording costs, or a term has a name that is taken.
        """
        if self.cost_terms is None:
            raise InvalidArgumentError(
                "this session has no cost_terms, so that recordings cost nothing that is known; give costs in costs.csv, or "
                "make the trial with cost_terms="
            )
        path, asked = self._asked(policy)
        lead = (len(there), *[1] * (len(policy.batch_shape) - 1))
        x, measured = (part.to(path.x).reshape(*lead, *part.shape[1:]) for part in recorded)
        v = x.diff(dim=-2) / self.dt
        seen = replace(path, x=x, v=v, plant=Measured(x, v, asked.stiffness, measured))
        found = self.cost_terms(seen)
        terms = dict(found) if isinstance(found, Mapping) else {TASK: found}
        if wrong := [name for name in terms if name in TAKEN or set(name) & set(',"\n')]:
            raise InvalidArgumentError(
                f"cost terms have to have names without commas that a session does not use itself ({', '.join(TAKEN)}), got "
                f"{', '.join(map(repr, wrong))}; give them others and tell again"
            )
        return {name: torch.where(there.reshape(lead), value, torch.inf) for name, value in terms.items()}

    def question(self, numbers: Sequence[int], recorded: Recorded, asked: Reference) -> list[Finding]:
        """What is to be said about the recordings of some roll-outs, see `torchds.sessions.questions`."""
        return question(self.layout, numbers, recorded.x, asked.x, self.dt)
