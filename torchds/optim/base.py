"""What the policy searches share: draw noise, evaluate a closure under it, keep the books."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor, nn

from torchds.costs import control_cost
from torchds.errors import AllRolloutsFailedError, InvalidArgumentError
from torchds.exploration.base import Exploration
from torchds.visits import Visit, listen

Closure = Callable[[], Tensor]


class Update(NamedTuple):
    """What the last step saw.

    Attributes:
        cost: `(N, *batch)` cost of each roll-out, control cost included; NaN or infinite where it failed.
        control: `(N, *batch)` the control cost in it.
        weights: `(N, *batch)` of the first group.
        failed: `(N, *batch)` True for roll-outs whose cost was not finite.
    """

    cost: Tensor
    control: Tensor
    weights: Tensor
    failed: Tensor


class _Told(NamedTuple):
    """Costs that were measured elsewhere, in the place of a closure."""

    costs: Tensor
    visits: Sequence[Visit]


class PolicySearch(torch.optim.Optimizer):
    """Base of optimizers that perturb parameters, look at costs and never at gradients.

    A subclass implements `_update` and its own `step`; everything else, from the noise to the checkpoint, is here.

    Args:
        params: parameters, named parameters or groups of them. A group may have its own `exploration`.
        exploration: shapes the noise of the groups that have none of their own.
        n_rollouts: N, roll-outs per update.
        defaults: options of a group: `lr` (scales the standard deviation of the noise, so the paper's α is lr²),
            `control_weight` (r of R = r I), and the subclass's own.
        batched: True: the closure is called once while every parameter carries N in front, and returns `(N, *batch)`.
            False: it is called N times, for any module, simulator or robot, and returns `(*batch)`.
        generator: of the unit normals, on the CPU; None for a new one with a fixed seed.
        control_reference: what the control cost is measured from: "demonstrated" (Eq. 12-13) or "zero" (Eq. 11).
    """

    def __init__(
        self,
        params: Iterable[Any],
        exploration: Exploration | None,
        n_rollouts: int,
        defaults: dict[str, Any],
        *,
        batched: bool,
        generator: torch.Generator | None,
        control_reference: str,
    ) -> None:
        if n_rollouts < 1:
            raise InvalidArgumentError(f"n_rollouts has to be at least 1, got {n_rollouts}")
        if control_reference not in ("demonstrated", "zero"):
            raise InvalidArgumentError(f"control_reference is 'demonstrated' or 'zero', got {control_reference!r}")
        self.n_rollouts = n_rollouts
        self.batched = batched
        self.control_reference = control_reference
        self.generator = generator if generator is not None else torch.Generator().manual_seed(0)
        self.explorations: list[Exploration] = []
        self.last: Update | None = None
        self._default_exploration = exploration
        super().__init__(params, defaults)

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
        for name, value in {**self.defaults, **param_group}.items():
            self._check_option(name, value)
        super().add_param_group(param_group)
        parameters = self.param_groups[-1]["params"]
        try:
            kinds = sorted({f"{p.dtype} on {p.device}" for p in parameters})
            if len(kinds) > 1:
                raise InvalidArgumentError(f"the parameters of a group need one dtype and device, got {kinds}")
            exploration.check(parameters)
        except Exception:
            self.param_groups.pop()
            raise
        self.explorations.append(exploration)

    def _check_option(self, name: str, value: Any) -> None:
        if name in ("lr", "control_weight") and not value >= 0:
            raise InvalidArgumentError(f"{name} has to be ≥ 0, got {value}")

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
        # The base keeps three entries only; copies need the generator and the explorations too.
        mine = ("n_rollouts", "batched", "control_reference", "explorations", "last", "_default_exploration")
        kept = {name: self.__dict__[name] for name in mine}
        return {**super().__getstate__(), **kept, "_generator_state": self.generator.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        state = dict(state)
        if (generator_state := state.pop("_generator_state", None)) is not None:
            self.generator = torch.Generator()
            self.generator.set_state(generator_state)
        super().__setstate__(state)

    # ------------------------------------------------------------------ the two halves of a step

    if TYPE_CHECKING:  # torch's own signature knows closures of floats only

        def step(self, closure: Closure | _Told | None = None) -> Tensor:  # type: ignore[override]
            """One update; every search has its own, since torch wraps it once per class for hooks."""

    @abstractmethod
    def _update(self, group: dict[str, Any], noise: list[Tensor], cost: Tensor) -> Tensor:
        """Change the parameters of one group and return the weights `(N, *batch)`."""

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
        return self.step(_Told(costs, visits))

    def _step(self, closure: Closure | _Told | None) -> Tensor:
        """One update; the body of every subclass's `step`."""
        if closure is None:
            raise InvalidArgumentError("step needs a closure that returns the cost of the roll-outs")
        asked = self._asked
        if not asked:
            self._draw(None)
        try:
            cost, control = self._evaluate(closure)
        except BaseException:
            if not asked:  # what ask() gave out stays valid, so that tell() can be tried again
                self._forget()
            raise
        failed = ~cost.isfinite()
        if failed.all():
            self._forget()
            raise AllRolloutsFailedError(
                f"all {cost.numel()} roll-outs had a cost that is not finite; the parameters are unchanged. Explore less "
                "(lr, mean_speed), or bound the roll-outs"
            )
        weights = [
            self._update(group, [self.state[p]["noise"] for p in group["params"]], cost) for group in self.param_groups
        ]
        self._forget()
        self.last = Update(cost, control, weights[0], failed)
        return torch.where(failed, 0.0, cost).sum(0) / (~failed).sum(0)

    @property
    def _asked(self) -> bool:
        """Whether noise is waiting for its costs."""
        return all("noise" in self.state[p] for group in self.param_groups for p in group["params"])

    def _forget(self) -> None:
        for group in self.param_groups:
            for p in group["params"]:
                self.state[p].pop("noise", None)

    def _draw(self, normals: Sequence[Sequence[Tensor]] | None) -> None:
        drawn = []
        for i, (group, exploration) in enumerate(zip(self.param_groups, self.explorations, strict=True)):
            shapes = [(self.n_rollouts, *p.shape) for p in group["params"]]
            if normals is None:
                # Drawn on the CPU and moved: the same noise on every device.
                unit = [
                    torch.randn(shape, generator=self.generator, dtype=p.dtype).to(p.device)
                    for shape, p in zip(shapes, group["params"], strict=True)
                ]
            else:
                unit = list(normals[i]) if i < len(normals) else []
                if [tuple(z.shape) for z in unit] != shapes:
                    raise InvalidArgumentError(
                        f"group {i} needs normals of shapes {shapes}, got {[tuple(z.shape) for z in unit]}"
                    )
            noise = exploration(group["params"], [group["lr"] * z for z in unit])
            drawn += list(zip(group["params"], noise, strict=True))
        for p, epsilon in drawn:
            self.state[p]["noise"] = epsilon

    # ------------------------------------------------------------------ evaluation

    def _evaluate(self, closure: Closure | _Told) -> tuple[Tensor, Tensor]:
        """Costs with control costs, and these alone, `(N, *batch)`; parameters are restored whatever the closure does."""
        parameters = [p for group in self.param_groups for p in group["params"]]
        center = {p: p.data for p in parameters}
        noise: dict[nn.Parameter, Tensor] = {p: self.state[p]["noise"] for p in parameters}
        if isinstance(closure, _Told):
            return self._add_control(closure.costs, closure.visits, center, noise, (self.n_rollouts,))
        try:
            if self.batched:
                return self._try(closure, center, noise, (self.n_rollouts,))
            pairs = [
                self._try(closure, center, {p: epsilon[n] for p, epsilon in noise.items()}, ())
                for n in range(self.n_rollouts)
            ]
        finally:
            for p, value in center.items():
                p.data = value
        return torch.stack([c for c, _ in pairs]), torch.stack([c for _, c in pairs])

    def _try(
        self,
        closure: Closure,
        center: dict[nn.Parameter, Tensor],
        noise: dict[nn.Parameter, Tensor],
        lead: tuple[int, ...],
    ) -> tuple[Tensor, Tensor]:
        for p, value in center.items():
            p.data = value + noise[p]
        with torch.no_grad(), listen() as visits:
            costs = closure()
        return self._add_control(costs, visits, center, noise, lead)

    def _add_control(
        self,
        costs: Any,
        visits: Sequence[Visit],
        center: dict[nn.Parameter, Tensor],
        noise: dict[nn.Parameter, Tensor],
        lead: tuple[int, ...],
    ) -> tuple[Tensor, Tensor]:
        if not isinstance(costs, Tensor):  # plain numbers take the parameters' precision
            costs = torch.as_tensor(costs, dtype=next(iter(center.values())).dtype)
        self._check_costs(costs, lead, list(center.values()))
        control = self._control(visits, center, noise, costs)
        return costs + control, control

    def _check_costs(self, costs: Tensor, lead: tuple[int, ...], parameters: list[Tensor]) -> None:
        batch = tuple(costs.shape[len(lead) :])
        if tuple(costs.shape[: len(lead)]) != lead or any(tuple(p.shape[: len(batch)]) != batch for p in parameters):
            raise InvalidArgumentError(
                f"the closure has to return costs of shape ({', '.join(map(str, lead))}{', ' if lead else ''}*batch) with "
                f"the parameters' own leading batch dimensions, got {tuple(costs.shape)} for parameters of shapes "
                f"{[tuple(p.shape) for p in parameters]}"
                + ("; for a module that does not broadcast over parameters use batched=False" if lead else "")
            )

    def _control(
        self,
        visits: Sequence[Visit],
        center: dict[nn.Parameter, Tensor],
        noise: dict[nn.Parameter, Tensor],
        costs: Tensor,
    ) -> Tensor:
        """½ Σ_t Υ_t (lines 16-17), summed over the points of every roll-out."""
        weight = {p: group["control_weight"] for group in self.param_groups for p in group["params"]}
        if not any(weight.values()):
            return torch.zeros_like(costs)

        def value_of(table: Mapping[nn.Parameter, Any], p: nn.Parameter, default: Tensor) -> Tensor:
            return torch.as_tensor(table.get(p, default), dtype=p.dtype, device=p.device)

        counted = False
        total = torch.zeros_like(costs)
        for policy, features in visits:
            r = policy.rows(lambda p: value_of(weight, p, torch.zeros(())).expand_as(center.get(p, p)))
            if not r.any():  # not one of the optimised policies, for example a reference
                continue
            counted = True
            deviation = policy.rows(lambda p: value_of(center, p, p.data))
            if self.control_reference == "demonstrated":
                deviation = deviation - policy.initial_rows
            epsilon = policy.rows(lambda p: value_of(noise, p, torch.zeros_like(p)))
            n_points = features.ndim - costs.ndim - 2
            for _ in range(n_points):
                deviation, epsilon, r = (m.unsqueeze(-3) for m in (deviation, epsilon, r))
            upsilon = control_cost(deviation.expand_as(epsilon), epsilon, features, r)
            total = total + 0.5 * upsilon.flatten(costs.ndim).sum(-1)
        if not counted:
            raise InvalidArgumentError(
                "control_weight > 0 needs to know which features the roll-outs of the optimised policy visited: use "
                "torchds.rollout in the closure, or call torchds.visits.report(policy, policy.features(x)) there, or give "
                "visits to tell(), or set control_weight=0"
            )
        return total
