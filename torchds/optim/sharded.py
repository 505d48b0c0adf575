"""One update by many processes: each tries its share of the roll-outs, and all of them make the same step.

Stability: stable.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

from torchds.devices import moved
from torchds.errors import InvalidArgumentError, ProcessLostError
from torchds.optim.evaluation import Closure, Table, Trial, evaluate
from torchds.sharing import Share, trying
from torchds.visits import Gated, Visit

Part = Tensor | Gated


def sharded(closure: Closure, group: dist.ProcessGroup | None = None) -> Sharded:
    """A closure whose N roll-outs are shared out over the processes of `torch.distributed`.

    Every process makes the same optimizer with the same seed and the same parameters, and calls `step(sharded(closure))`. All
    draw the same noise, since it comes from the seed; process r of R tries the roll-outs from N r/R up to N (r+1)/R. Costs, and
    what the roll-outs visited, go to all processes, which make the same update: that of one process, bit for bit, where a
    roll-out's numbers do not depend on its company, as those of `torchds.rollout(backend="fused")` do not.

    What a batched closure draws by itself, noise of the system say, is that of one process too if it is drawn by
    `torchds.sharing.drawn`; otherwise it is another in each process, as it would be on robots.

    Args:
        closure: as for any search of `torchds.optim`, batched or not.
        group: the processes; None for all. Where torch.distributed was not initialised there is one.

    Returns:
        A closure for `step`. A call of it is one of `closure`, the same in all processes.

    Raises:
        InvalidArgumentError: from `step`, if the processes do not try the same policies.
        RuntimeError: from `step`, in all processes, if the closure raised in another one. The parameters are as they were.
        ProcessLostError: from `step`, if another process has ended, or is silent for longer than the time out of the group
            (`torch.distributed.init_process_group(timeout=...)`). The parameters are as they were; the group is of no more use.

    Example:
        >>> import torch, torchds
        >>> theta = torch.nn.Parameter(torch.zeros(2))
        >>> optim = torchds.optim.PIBB([theta], torchds.exploration.Gaussian(0.3))
        >>> cost = optim.step(torchds.optim.sharded(lambda: (theta - 1.0).square().sum(-1)))  # torchrun, or one process
    """
    return Sharded(closure, group)


class Sharded:
    """What `sharded` returns; a search evaluates it by `torchds_trial`, other searches by `together`."""

    def __init__(self, closure: Closure, group: dist.ProcessGroup | None = None) -> None:
        if not callable(closure):
            raise InvalidArgumentError(
                f"sharded needs a closure that returns the cost of the roll-outs, got {closure!r}"
            )
        self.closure, self.group = closure, group

    def __call__(self) -> Tensor:
        """The closure at the parameters as they stand."""
        return self.closure()

    def torchds_trial(self, noise: Table, n_rollouts: int, batched: bool) -> Trial:
        """The trial of all roll-outs, of which this process makes its share.

        Args:
            noise: `(N, *shape)` for each parameter, the same in all processes.
            n_rollouts: N.
            batched: as for `PolicySearch`.
        """
        visits: list[Visit] = []

        def tried(mine: slice) -> list[Part]:
            share = Share(mine.start, mine.stop, n_rollouts) if batched else None
            with trying(share):
                trial = evaluate(self.closure, {p: e[mine] for p, e in noise.items()}, mine.stop - mine.start, batched)
            visits.extend(trial.visits)
            return [trial.costs, *(visit.visited for visit in trial.visits)]

        policies = [tensor for p, epsilon in noise.items() for tensor in (p.data, epsilon)]
        costs, *visited = self.together(n_rollouts, tried, policies)
        assert isinstance(costs, Tensor)
        return Trial(costs, [Visit(visit.policy, part) for visit, part in zip(visits, visited, strict=True)])

    def together(self, n: int, tried: Callable[[slice], Sequence[Part]], policies: Sequence[Tensor]) -> Sequence[Part]:
        """What all processes found out about n policies, of which this one tries its share.

        Args:
            n: the number of policies.
            tried: tries those of a slice, at least one, and returns what has them in front.
            policies: all of them; they have to be the same in all processes.

        Returns:
            What `tried` returns, of all n.
        """
        if not (dist.is_available() and dist.is_initialized()):
            return tried(slice(0, n))
        rank, size = dist.get_rank(self.group), dist.get_world_size(self.group)
        first, last = n * rank // size, n * (rank + 1) // size
        said: dict[str, Any] = {"policies": _digest(policies)}
        raised: Exception | None = None
        own: Sequence[Part] = ()
        try:
            own = tried(slice(first, max(last, first + 1)))  # one at least, which shows what a roll-out reports
            said["share"] = [moved(_cut(part, last - first), "cpu") for part in own]
        except Exception as error:
            raised, said["error"] = error, f"{type(error).__name__}: {error}"
        everyone: list[Any] = [None] * size
        try:
            dist.all_gather_object(everyone, said, self.group)
        except RuntimeError as error:
            raise ProcessLostError(
                f"process {rank} of {size} has lost another one, which has ended or was silent for too long "
                f"({str(error).splitlines()[0]}); begin them all again, from the last checkpoint"
            ) from (raised or error)
        if raised is not None:
            raise raised
        for other, told in enumerate(everyone):
            if "error" in told:
                raise RuntimeError(f"the closure raised in process {other}: {told['error']}")
            if told["policies"] != said["policies"]:
                raise InvalidArgumentError(
                    f"processes {rank} and {other} do not try the same policies: give all optimizers the same generator seed, "
                    "and the same parameters to begin with"
                )
        shares = zip(own, *(told["share"] for told in everyone), strict=True)
        return [_join([_like(mine, part) for part in parts]) for mine, *parts in shares]


def _digest(policies: Sequence[Tensor]) -> str:
    found = hashlib.sha256()
    for tensor in policies:
        found.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return found.hexdigest()


def _cut(part: Part, n: int) -> Part:
    """The first n roll-outs."""
    return Gated(*(field[:n] for field in part)) if isinstance(part, Gated) else part[:n]


def _like(mine: Part, part: Part) -> Part:
    """A part on the device of this process's own."""
    found: Part = moved(part, (mine.inputs if isinstance(mine, Gated) else mine).device)
    return found


def _join(parts: Sequence[Any]) -> Any:
    """All roll-outs."""
    if isinstance(parts[0], Gated):
        return Gated(*(torch.cat(fields) for fields in zip(*parts, strict=True)))
    return torch.cat(list(parts))
