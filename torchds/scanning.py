"""Roll-outs as one node of a graph: torch's scan over time, for programs that are compiled or exported.

A loop in Python becomes T copies of its body in a graph, which takes minutes to compile from some fifty steps on.

Stability: experimental.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchds.moments import Moment, Rollout


class Taken(NamedTuple):
    """What one step of a roll-out was, beside the moment that it leads to."""

    input: Tensor
    features: Tensor
    stiffness: Tensor | None


Step = Callable[[Moment, Any], tuple[Moment, Taken]]
"""(moment, time [s]) -> the next moment, and what led there."""


def scanned(step: Step, start: Moment, n_steps: int, dt: float) -> Rollout:
    """The roll-out of `n_steps` steps from `start`; the time that `step` sees is a tensor."""
    from torch._higher_order_ops.scan import scan  # torch has no public name for it yet

    def body(carry: tuple[Tensor, ...], t: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        after, taken = step(_moment(carry, start), t)
        kept = [part for part in taken if part is not None]
        # What is carried on and what is kept have to be tensors of their own; a constant force, say, is none.
        carried = tuple(part.clone() for part in _tensors(after))
        return carried, tuple(part.clone() for part in (*carried, *kept))

    times = dt * torch.arange(n_steps, dtype=start.x.dtype, device=start.x.device)
    begun = _tensors(start)
    if torch.compiler.is_compiling():
        _, kept = scan(body, begun, times)
    else:
        # Another time step is another program: as a symbol it has no gradients. What torch warns of is itself.
        with warnings.catch_warnings(), torch._dynamo.config.patch(specialize_float=True):
            warnings.simplefilter("ignore")
            _, kept = scan(body, begun, times)
    axis = start.x.ndim - 1  # of time
    kept = [part.movedim(0, axis) for part in kept]
    whole = [torch.cat([first.unsqueeze(axis), part], axis) for first, part in zip(begun, kept, strict=False)]
    track, (inputs, features, *stiffness) = _moment(whole, start), kept[len(begun) :]
    tracked = track.plant
    return Rollout(
        x=track.x if tracked is None else tracked.x,
        v=(track if tracked is None else tracked).v[..., 1:, :],
        visited=features,
        dt=dt,
        resting=None if track.resting is None else track.resting[..., 1:],
        stiffness=stiffness[0] if stiffness else None,
        reference=track.x,
        inputs=inputs,
        plant=tracked,
    )


def _tensors(moment: Moment) -> tuple[Tensor, ...]:
    """All tensors of a moment, one after the other; laid out alike in every step, as scan wants them."""
    resting = () if moment.resting is None else (moment.resting,)
    parts = (moment.x, moment.v, *resting, *(() if moment.plant is None else moment.plant))
    return tuple(part.contiguous() for part in parts)


def _moment(tensors: Any, like: Moment) -> Moment:
    """The moment of these tensors, with the parts that another one has."""
    x, v, *rest = tensors
    resting = None if like.resting is None else rest.pop(0)
    return Moment(x, v, resting, None if like.plant is None else type(like.plant)(*rest))
