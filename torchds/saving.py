"""A policy from its file (`torchds/policy_file.py`).

Stability: stable.
"""

from __future__ import annotations

from pathlib import Path

import torch

from torchds import policy_file
from torchds.errors import FileError, TorchdsError
from torchds.files import reason
from torchds.policy import GMRPolicy


def load_policy(path: str | Path) -> GMRPolicy:
    """The policy in a file that `GMRPolicy.save` wrote, with `info`: goal, P, names, units, dt, versions.

    Raises:
        FileError: there is no such file, it is damaged, of another version, or holds no policy.
    """
    values, info = policy_file.read(path)
    try:
        identity = torch.eye(values["means"].shape[-1]).expand_as(
            values["factors"]
        )  # the factors themselves come below
        initial = [values[f"initial_{name}"] for name in ("A", "b", "stiffness_A", "stiffness_b")]
        policy = GMRPolicy(values["priors"], values["means"], identity, *initial)
        for name in {*dict(policy.named_buffers()), *policy.row_parameters}:
            getattr(policy, name).data = values[name]
    except (KeyError, TypeError, AttributeError, RuntimeError, TorchdsError) as error:
        raise FileError(f"{path} holds no policy of this version: {reason(error)}") from error
    policy.info = info
    return policy
