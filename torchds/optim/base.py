"""What the policy searches share: draw noise, evaluate a closure under it, keep the books.

Stability: stable.
"""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Unpack

import torch
from torch import Tensor, nn

from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.optim.elite import put_first, remember
from torchds.optim.evaluation import Closure, Control, Trial, controls, evaluate
from torchds.optim.options import DEFAULTS, SharedOptions, check_group, completed, described
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


@cache
def _of_torch() -> frozenset[str]:
    """Attributes that torch and its schedulers give an optimizer: hooks and wrappers, which copies do not take along.

    Asked for when something is copied: torch's first optimizer imports its compiler.
    """
    return frozenset({*vars(torch.optim.Optimizer([{"params": []}], {})), "step"})


class PolicySearch(torch.optim.Optimizer):
    """Base of optimizers that perturb parameters, look at costs and never at gradients.

    A subclass implements `_update` and its own `step`; everything else, from the noise to the checkpoint, is here.

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
        if n_rollouts < 1:
            raise InvalidArgumentError(f"n_rollouts has to be at least 1, got {n_rollouts}")
        if options["elite"] != "none" and n_rollouts < 2:
            raise InvalidArgumentError(f"elite={options['elite']!r} needs n_rollouts ≥ 2, got {n_rollouts}")
        self.n_rollouts = n_rollouts
        self.elite = options["elite"]
        self.batched = options["batched"]
        self.control_reference = options["control_reference"]
        self.generator = options["generator"] or torch.Generator().manual_seed(0)
        self.explorations: list[Exploration] = []
        self.last: Update | None = None
        self._default_exploration = exploration
        in_groups = {name: options[name] for name in ("eliteness", "temperature", "control_weight")}
        super().__init__(params, {**defaults, **in_groups})

    # ------------------------------------------------------------------ groups and state

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add a group; its entry `exploration` is kept as an attribute, since groups hold plain values only.

        Raises:
            InvalidArgumentError: options out of range, mixed dtypes or devices, no exploration or one that does not
                fit the parameters.
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
            if len(kinds) > 1:
                raise InvalidArgumentError(f"the parameters of a group need one dtype and device, got {kinds}")
            exploration.check(parameters)
            self._check_promise(self.param_groups[-1], exploration)
        except Exception:
            self.param_groups.pop()
            raise
        self.explorations.append(exploration)

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

    def state_dict(self) -> dict[str, Any]:
        """Parameters' state and groups as in torch.optim, and the generator and explorations beside them."""
        extra = {
            "generator": self.generator.get_state(),
            "explorations": [exploration.state_dict() for exploration in self.explorations],
        }
        return {**super().state_dict(), **extra}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Continue bit for bit where `state_dict` was taken."""
        super().load_state_dict({key: state_dict[key] for key in ("state", "param_groups")})
        self.generator.set_state(state_dict["generator"].cpu())
        for exploration, state in zip(self.explorations, state_dict["explorations"], strict=True):
            exploration.load_state_dict(state)

    def __getstate__(self) -> dict[str, Any]:
        """What copies and pickles keep: all attributes but those of torch, the generator by its state."""
        own = {name: value for name, value in vars(self).items() if name not in _of_torch()}
        return {**super().__getstate__(), **own, "generator": self.generator.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if isinstance(state.get("generator"), Tensor):  # torch.optim's load_state_dict comes here with parts only
            generator = torch.Generator()
            generator.set_state(state["generator"])
            state = {**state, "generator": generator}
        super().__setstate__(state)

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
        self._draw(normals)
        named = [
            (name, p + self.state[p]["noise"])
            for group in self.param_groups
            for name, p in zip(group.get("param_names", [None] * len(group["params"])), group["params"], strict=True)
        ]
        return dict(named) if all(name is not None for name, _ in named) else [value for _, value in named]

    def tell(self, costs: Tensor, visits: Sequence[Visit] = ()) -> Tensor:
        """Finish the update that `ask` began.

        Args:
            costs: `(N, *batch)` what the tried parameters cost; NaN or infinity marks a failed roll-out.
            visits: the features that the roll-outs saw, `Visit(policy, features)` with `(N, *batch, *points, T, F)`,
                for the control cost; needed only for a control_weight above zero.

        Raises:
            InvalidArgumentError: nothing was asked, or costs of the wrong shape.
            AllRolloutsFailedError: no cost is finite.
        """
        if not self._asked:
            raise InvalidArgumentError("tell(costs) finishes what ask() began; call ask() first")
        dtype = self.param_groups[0]["params"][0].dtype
        return self.step(Trial(costs if isinstance(costs, Tensor) else torch.as_tensor(costs, dtype=dtype), visits))

    def _step(self, closure: Closure | Trial | None) -> Tensor:
        """One update; the body of every subclass's `step`."""
        if closure is None:
            raise InvalidArgumentError("step needs a closure that returns the cost of the roll-outs")
        for group, exploration in zip(
            self.param_groups, self.explorations, strict=True
        ):  # schedules and users write options
            self._check_options(group)
            self._check_promise(group, exploration)
        asked = self._asked
        if not asked:
            self._draw(None)
        groups = [(group, [self.state[p]["noise"] for p in group["params"]]) for group in self.param_groups]
        noise = {p: epsilon for group, all_ in groups for p, epsilon in zip(group["params"], all_, strict=True)}
        try:
            trial = evaluate(closure, noise, self.n_rollouts, self.batched) if callable(closure) else closure
            self._check_costs(trial.costs, noise)
            weight = {p: float(group["control_weight"]) for group, _ in groups for p in group["params"]}
            informed = self.costs_per_step or any(weight.values())
            control = controls(trial.visits, noise, weight, self.control_reference) if informed else []
            self._check_control(trial.costs, control)
        except BaseException:
            if not asked:  # what ask() gave out stays valid, so that tell() can be tried again
                self._forget()
            raise
        cost = trial.costs.sum(-1) if self.costs_per_step else trial.costs
        effort = torch.zeros_like(cost)
        for part in control:
            effort = effort + 0.5 * part.upsilon.flatten(cost.ndim).sum(-1)
        cost = cost + effort
        failed = ~cost.isfinite()
        if failed.all():
            self._forget()
            raise AllRolloutsFailedError(
                f"all {cost.numel()} roll-outs had a cost that is not finite; the parameters are unchanged. Explore less "
                "(lr, mean_speed), or bound the roll-outs"
            )
        if self.elite == "best":
            remember(cost, noise, self.state)
        weights = [self._update(group, epsilons, cost, trial.costs, control) for group, epsilons in groups]
        self._forget()
        self.last = Update(cost, effort, weights[0], failed)
        return torch.where(failed, 0.0, cost).sum(0) / (~failed).sum(0)

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

    @property
    def _asked(self) -> bool:
        """Whether noise is waiting for its costs."""
        return all("noise" in self.state[p] for group in self.param_groups for p in group["params"])

    def _forget(self) -> None:
        for group in self.param_groups:
            for p in group["params"]:
                self.state[p].pop("noise", None)

    def _draw(self, normals: Sequence[Sequence[Tensor]] | None) -> None:
        proposed = self._propose(normals)
        noise = {
            p: epsilon
            for group, epsilons in zip(self.param_groups, proposed, strict=True)
            for p, epsilon in zip(group["params"], epsilons, strict=True)
        }
        put_first(self.elite, noise, self.state)
        for p, epsilon in noise.items():
            self.state[p]["noise"] = epsilon

    def _propose(self, normals: Sequence[Sequence[Tensor]] | None) -> list[list[Tensor]]:
        """The noise `(N, *shape)` that the next update tries, per group and parameter.

        Args:
            normals: unit normals to use in place of drawn ones, per group and parameter `(N, *shape)`.
        """
        if normals is None:
            normals = self._normals(self.n_rollouts)
        noise = []
        for i, group in enumerate(self.param_groups):
            shapes = [(self.n_rollouts, *p.shape) for p in group["params"]]
            unit = list(normals[i]) if i < len(normals) else []
            if [tuple(z.shape) for z in unit] != shapes:
                raise InvalidArgumentError(
                    f"group {i} needs normals of shapes {shapes}, got {[tuple(z.shape) for z in unit]}"
                )
            noise.append(self._shape(group, self.explorations[i], unit))
        return noise

    def _normals(self, n: int) -> list[list[Tensor]]:
        """Unit normals `(n, *shape)` per group and parameter, drawn on the CPU and moved: the same on every device."""
        return [
            [torch.randn((n, *p.shape), generator=self.generator, dtype=p.dtype).to(p.device) for p in group["params"]]
            for group in self.param_groups
        ]

    def _shape(self, group: dict[str, Any], exploration: Exploration, normals: list[Tensor]) -> list[Tensor]:
        """The noise `(n, *shape)` of a group's parameters that `normals` of the same shapes become."""
        return exploration(group["params"], [group["lr"] * z for z in normals])
