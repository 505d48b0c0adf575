"""All or nothing: what a step may change, put back as it was where the step raises.

Stability: experimental.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor

from torchds import visits


class Snapshot:
    """Parameters, state, groups, generator and explorations of a search, as they are now.

    Taken before a step, so that an exception of any kind, an interruption by the keyboard among them, leaves nothing half done:

    >>> import torch, torchds
    >>> theta = torch.nn.Parameter(torch.zeros(2))
    >>> optim = torchds.optim.PIBB([theta], torchds.exploration.Gaussian(0.3))
    >>> before = Snapshot(optim)
    >>> cost = optim.step(lambda: theta.square().sum(-1))
    >>> before.restore()
    >>> bool((theta == 0).all())
    True

    Args:
        search: the optimizer that may be restored.
    """

    def __init__(self, search: Any) -> None:
        self._search, self._last = search, search.last
        self._listener = visits.listener.get()
        self._group_list = search.param_groups
        self._groups = [(group, dict(group)) for group in search.param_groups]
        self._parameters = [(p, p.data, p.data.clone()) for p in search.parameters]
        self._state_table = search.state
        self._state = {p: _copied(entries) for p, entries in search.state.items()}
        self._generator = search.generator, search.generator.get_state()
        self._explorations = [(e, copy.deepcopy(e.state_dict())) for e in search.explorations]

    @torch.no_grad()
    def restore(self) -> None:
        """Put everything back; an interruption of this begins it once more."""
        try:
            self._restore()
        except BaseException:
            self._restore()
            raise

    def _restore(self) -> None:
        search = self._search
        for p, data, values in self._parameters:
            p.data = data
            p.data.copy_(values)
        for group, options in self._groups:
            group.update(options)
            for name in group.keys() - options.keys():
                del group[name]
        search.param_groups = self._group_list
        search.state = self._state_table  # and not one that loading has put in its place
        search.state.clear()
        search.state.update({p: dict(entries) for p, entries in self._state.items()})
        search.last = self._last
        visits.listener.set(self._listener)
        search.generator = self._generator[0]
        search.generator.set_state(self._generator[1])
        for exploration, state in self._explorations:
            exploration.load_state_dict(state)


def _copied(entries: dict[str, Any]) -> dict[str, Any]:
    # Noise is as large as all the rest together, and nothing changes it in place.
    return {name: value if name == "noise" else _own(value) for name, value in entries.items()}


def _own(value: Any) -> Any:
    return value.clone() if isinstance(value, Tensor) else copy.deepcopy(value)
