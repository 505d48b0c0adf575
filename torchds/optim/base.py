"""What the policy searches share: draw noise, evaluate a closure under it, keep the books.

Stability: stable.
"""

from __future__ import annotations

import functools
import inspect
import warnings
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Unpack

import torch
from torch import Tensor, nn

from torchds.arrays import shown, without_autocast
from torchds.errors import AllRolloutsFailedError, EqualCostsWarning, InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.checkpoints import check_entries, finite
from torchds.optim.drawing import Drawing
from torchds.optim.elite import remember
from torchds.optim.evaluation import Closure, Control, Table, Trial, as_costs, controls, evaluate
from torchds.optim.functional import failures, informative
from torchds.optim.options import DEFAULTS, IN_GROUPS, SharedOptions, check_group, check_search, completed, described
from torchds.optim.transaction import Snapshot
from torchds.visits import Visit


class Update(NamedTuple):
    """What the last step saw.

    Attributes:
        cost: `(N, *batch)` cost of each roll-out, control cost included; NaN or infinite where it failed.
        control: `(N, *batch)` the control cost in it.
        weights: `(N, *batch)` of the first group; their mean over time where there is one per step.
        failed: `(N, *batch)` True for roll-outs whose cost was not finite.
    """

    cost: Tensor
    control: Tensor
    weights: Tensor
    failed: Tensor


class PolicySearch(Drawing):
    """Base of optimizers that perturb parameters, look at costs and never at gradients.

    A subclass implements `_update` and its own `step`; everything else, from the noise to the checkpoint, is here.

    Parameters with requires_grad=False are frozen: they get no noise, do not move and cost no control. A step is all or
    nothing: whatever it raises, parameters, state and generator are as before it, and so is what `ask` gave out. Where all
    roll-outs of a run cost the same, nothing is known to be better, and its parameters stay.

    Args:
        params: parameters, named parameters or groups of them. A group may have its own `exploration`.
        exploration: shapes the noise of the groups that have none of their own.
        n_rollouts: N, roll-outs per update.
        defaults: options of a group that are not shared by all searches: `lr` (scales the standard deviation of the noise,
            so the paper's α is lr²) and the subclass's own.
        **shared: the shared options below.

    Raises:
        UnknownNameError: an option that this search does not have.
        InvalidArgumentError: an option out of its range, or parameters that the exploration does not know.
    """

    costs_per_step = False
    """Whether the closure returns a cost for every time step, and the update needs to know what was visited then."""

    shared_defaults: ClassVar[SharedOptions] = DEFAULTS
    """Of the shared options; a subclass that wants others says so here."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__doc__ = f"{inspect.cleandoc(cls.__doc__ or '')}\n\n{described(cls.shared_defaults)}"

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None,
        n_rollouts: int,
        defaults: dict[str, Any],
        **shared: Unpack[SharedOptions],
    ) -> None:
        options = completed(shared, self.shared_defaults, type(self))
        self.elite = options["elite"]
        self.batched = options["batched"]
        self.control_reference = options["control_reference"]
        self.n_rollouts, self.generator = check_search(
            n_rollouts, self.elite, self.control_reference, self.batched, options["generator"]
        )
        self.explorations: list[Exploration] = []
        self.last: Update | None = None
        self._default_exploration = exploration
        self._warned = False
        in_groups = {name: value for name, value in options.items() if name in IN_GROUPS}
        super().__init__(params, {**defaults, **in_groups})

    # ------------------------------------------------------------------ groups and state

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add a group; its entry `exploration` is kept as an attribute, since groups hold plain values only.

        Raises:
            InvalidArgumentError: options out of range, no parameters, mixed dtypes or devices, no exploration or one that
                does not fit the parameters.
        """
        param_group = dict(param_group)
        exploration = param_group.pop("exploration", self._default_exploration)
        if not isinstance(exploration, Exploration):
            raise InvalidArgumentError(
                f"a group needs an exploration, e.g. exploration=torchds.exploration.Gaussian(0.1); got {exploration!r}"
            )
        self._check_options({**self.defaults, **param_group})
        super().add_param_group(param_group)
        parameters = self.param_groups[-1]["params"]
        try:
            kinds = sorted({f"{p.dtype} on {p.device}" for p in parameters})
            if len(kinds) != 1 or not parameters[0].is_floating_point():
                raise InvalidArgumentError(
                    f"the parameters of a group need one dtype and device, a real one, got {kinds}"
                )
            exploration.check(parameters)
            self._check_promise(self.param_groups[-1], exploration)
        except Exception:
            self.param_groups.pop()
            raise
        self.explorations.append(exploration)
        self._forget()  # what was asked for the other groups alone

    def _check_promise(self, group: Mapping[str, Any], exploration: Exploration) -> None:
        if exploration.needs_convex_update and not self._convex(group):
            raise InvalidArgumentError(
                f"{type(exploration).__name__} keeps its promise only for updates that are convex combinations of the "
                f"roll-outs, and those of {type(self).__name__} with these options are none; {self._convex_instead}"
            )

    _convex_instead = "use PIBB"

    def _convex(self, group: Mapping[str, Any]) -> bool:
        """Whether the update of each slope in this group is a convex combination of the roll-outs' noise."""
        return True

    def _check_options(self, group: Mapping[str, Any]) -> None:
        """Refuse options of a group that are out of their range.

        Raises:
            InvalidArgumentError: what was received and what is allowed.
        """
        check_group(group)

    # ------------------------------------------------------------------ the two halves of a step

    if TYPE_CHECKING:  # torch's own signature knows closures of floats only

        def step(self, closure: Closure | Trial | None = None) -> Tensor:  # type: ignore[override]
            """One update; every search has its own, since torch wraps it once per class for hooks."""

    @abstractmethod
    def _update(
        self, group: dict[str, Any], noise: list[Tensor], cost: Tensor, steps: Tensor, control: list[Control]
    ) -> Tensor:
        """Change the parameters of one group.

        Args:
            group: the group.
            noise: `(N, *shape)` for each of its parameters.
            cost: `(N, *batch)` of whole roll-outs, control cost included.
            steps: what the closure returned, per step where `costs_per_step` says so.
            control: Υ along the roll-outs; empty if the control weight is zero.

        Returns:
            The weights `(N, *batch)`.
        """

    @torch.no_grad()
    def ask(self, normals: Sequence[Sequence[Tensor]] | None = None) -> Any:
        """Draw the noise of the next update and return the parameters to try.

        Args:
            normals: unit normals to use in place of drawn ones, per group and parameter `(N, *shape)`.

        Returns:
            A dict of `(N, *shape)` by name where the optimizer was made from named parameters, else a list in the order
            of the parameters. The noise is part of `state_dict` until `tell`.

        Raises:
            InvalidArgumentError: normals of the wrong number or shape.
        """
        self._check()
        before = Snapshot(self)
        try:
            with without_autocast(self._first):
                self._draw(normals)
            return self._by_name({p: p + self.state[p]["noise"] for p in self.parameters})
        except BaseException:
            before.restore()
            raise

    def _by_name(self, values: Mapping[nn.Parameter, Tensor]) -> Any:
        """A dict by name where the optimizer was made from named parameters, else a list in the order of the parameters."""
        named = [
            (name, values[p])
            for group in self.param_groups
            for name, p in zip(group.get("param_names", [None] * len(group["params"])), group["params"], strict=True)
        ]
        return dict(named) if all(name is not None for name, _ in named) else [value for _, value in named]

    def tell(self, costs: Any, visits: Sequence[Visit] = ()) -> Tensor:
        """Finish the update that `ask` began.

        Args:
            costs: `(N, *batch)` what the tried parameters cost, as a tensor, an array or numbers; NaN or infinity marks a
                failed roll-out.
            visits: the features that the roll-outs saw, `Visit(policy, features)` with `(N, *batch, *points, T, F)`,
                for the control cost; needed only for a control_weight above zero.

        Raises:
            InvalidArgumentError: nothing was asked, or costs of the wrong shape; what `ask` gave out stays valid.
            AllRolloutsFailedError: no cost is finite.
        """
        if not self._asked:
            raise InvalidArgumentError("tell(costs) finishes what ask() began; call ask() first")
        return self.step(Trial(as_costs(costs, self.parameters), visits))

    def _step(self, closure: Closure | Trial | None) -> Tensor:
        """One update; the body of every subclass's `step`."""
        if not callable(closure) and not isinstance(closure, Trial):
            raise InvalidArgumentError(
                f"step needs a closure that returns the cost of the roll-outs, got {shown(closure)}; where costs are known, "
                "use ask() and tell(costs)"
            )
        self._check()
        before = Snapshot(self)
        try:
            return self._learn(closure)
        except BaseException:
            before.restore()
            raise

    def _learn(self, closure: Closure | Trial) -> Tensor:
        with without_autocast(self._first):
            if not self._asked:
                self._draw(None)
        groups = [(group, [self.state[p]["noise"] for p in group["params"]]) for group in self.param_groups]
        noise = {p: epsilon for group, all_ in groups for p, epsilon in zip(group["params"], all_, strict=True)}
        trial = evaluate(closure, noise, self.n_rollouts, self.batched) if callable(closure) else closure
        self._check_costs(trial.costs, noise)
        with without_autocast(self._first):
            return self._weigh(groups, noise, trial)

    def _weigh(self, groups: list[tuple[dict[str, Any], list[Tensor]]], noise: Table, trial: Trial) -> Tensor:
        """The update, from what was tried and what it cost."""
        weight = {p: float(group["control_weight"]) * p.requires_grad for group, _ in groups for p in group["params"]}
        informed = self.costs_per_step or any(weight.values())
        control = controls(trial.visits, noise, weight, self.control_reference) if informed else []
        self._check_control(trial.costs, control)
        cost = trial.costs.sum(-1) if self.costs_per_step else trial.costs
        efforts = [0.5 * part.upsilon.flatten(cost.ndim).sum(-1) for part in control]
        effort = functools.reduce(torch.add, efforts) if efforts else torch.zeros_like(cost)
        cost = cost + effort
        failed = failures(cost)
        if failed.all():
            raise AllRolloutsFailedError(
                f"all {cost.numel()} roll-outs had a cost that is not finite; the parameters are unchanged. Explore less "
                "(lr, mean_speed), or bound the roll-outs"
            )
        if self.elite == "best":
            remember(cost, noise, self.state)
        moves = informative(cost)
        before = {} if moves.all() else {p: p.detach().clone() for p in noise}
        weights = [self._update(group, epsilons, cost, trial.costs, control) for group, epsilons in groups]
        if before:
            self._stay(~moves, before)
        if not all(map(finite, self.parameters)):
            raise InvalidArgumentError(
                "the update leads to parameters beyond the largest number; the parameters are unchanged. Explore less (lr)"
            )
        self._forget()
        self.last = Update(cost, effort, weights[0], failed)
        valid, n = cost.masked_fill(failed, 0.0), len(cost) - failed.sum(0)
        mean = valid.sum(0) / n
        if finite(mean):
            return mean
        return torch.where(mean.isinf(), (valid / n).sum(0), mean)  # a sum beyond the largest number

    def _stay(self, equal: Tensor, before: Mapping[nn.Parameter, Tensor]) -> None:
        """Take back the update of the runs `(*batch)` in which no roll-out was better than another."""
        for p, value in before.items():
            p.copy_(torch.where(equal.reshape(*equal.shape, *(1,) * (p.ndim - equal.ndim)), value, p))
        if not self._warned and any(float(group["lr"]) > 0 for group in self.param_groups):
            warnings.warn(
                f"all roll-outs of {int(equal.sum())} of {equal.numel()} runs cost the same, and nothing was learned from "
                "them: the parameters stay. Explore more, free parameters (requires_grad), or let the cost depend on them",
                EqualCostsWarning,
                stacklevel=2,
            )
            self._warned = True

    def scalars(self) -> dict[str, float]:
        """What is worth logging after each update, by TensorBoard tag; means over the runs of a batch.

        Returns:
            The width of the noise and what the explorations say; once there was an update, the entropy of its weights and the
            mean cost of its roll-outs that did not fail.
        """
        found = {"exploration/lr": float(self.param_groups[0]["lr"])}
        for exploration in self.explorations:
            found |= exploration.scalars()
        if (last := self.last) is not None:
            w = last.weights
            found["weights/entropy"] = float(torch.special.entr(w).sum(0).mean())
            found["exploration/mean_cost"] = float(last.cost[~last.failed].mean())
        return found

    def _check(self) -> None:
        """Refuse options, parameters and state that cannot be used as they are now: all may have been written from outside."""
        self.n_rollouts, _ = check_search(
            self.n_rollouts, self.elite, self.control_reference, self.batched, self.generator
        )
        for group, exploration in zip(self.param_groups, self.explorations, strict=True):
            self._check_options(group)
            self._check_promise(group, exploration)
        if not all(map(finite, self.parameters)):
            raise InvalidArgumentError("parameters have to be finite before a step; some are NaN or infinite")
        check_entries(
            self, self.state, ", which belongs to other parameters or options; make a new optimizer for these"
        )

    def _check_costs(self, costs: Tensor, noise: Mapping[nn.Parameter, Tensor]) -> None:
        batch = tuple(costs.shape[1:-1] if self.costs_per_step else costs.shape[1:])
        per_step = ", T" if self.costs_per_step else ""
        if tuple(costs.shape[:1]) != (self.n_rollouts,) or any(p.shape[: len(batch)] != batch for p in noise):
            raise InvalidArgumentError(
                f"the closure has to return costs of shape ({self.n_rollouts}, *batch{per_step}) (or tell() to be given "
                f"them), or of shape (*batch{per_step}) with batched=False, where *batch are the parameters' own leading "
                f"batch dimensions, got {tuple(costs.shape)} for parameters of shapes {[tuple(p.shape) for p in noise]}; "
                "for a module that does not broadcast over parameters use batched=False"
            )

    def _check_control(self, costs: Tensor, control: list[Control]) -> None:
        """Refuse roll-outs that the update cannot use, before anything changes.

        Raises:
            InvalidArgumentError: what was received and what is allowed.
        """
