"""The force-field tasks in plain numpy, one policy and one execution at a time."""

import numpy as np
import pytest
import torch

from tests.fitted import fitted_once  # noqa: F401


@pytest.fixture
def tracked():
    """Positions and velocities (T+1, 2), accelerations and applied stiffness (T, 2) of a unit point mass.

    `form` "implicit" is Eq. 33 as printed, solved for the velocity; "explicit" is that of the released program.
    """

    def run(policy, r, start, n_steps, force, form, low, high):
        A, b, slopes, offsets = (
            getattr(policy, name)[r].detach().numpy() for name in ("A", "b", "stiffness_A", "stiffness_b")
        )
        dt = 0.1
        reference = q = np.array(start)
        qd = v_before = np.zeros(2)
        x, v, a, stiffness = [q], [qd], [], []
        for _ in range(n_steps):
            h = policy.gating(torch.from_numpy(reference)).numpy()
            v_ref = sum(h[k] * (A[k] @ reference + b[k]) for k in range(len(h)))
            s = sum(h[k] * (slopes[k] @ reference + offsets[k]) for k in range(len(h)))
            s = np.minimum(np.maximum(s, low), high) * np.ones(2)
            D, F = 2 * np.sqrt(s), force(q)
            if form == "explicit":
                reference = reference + v_ref * dt
                qdd = s * (reference - q) + D * (v_ref - qd) - qd + F
                qd = qd + qdd * dt
            else:
                faster = (qd / dt - qd + F + s * (reference - q) + D * v_before) / (1 / dt + s * dt + D)
                qdd, qd = (faster - qd) / dt, faster
                reference = reference + v_ref * dt
            v_before = v_ref
            q = q + qd * dt
            x.append(q)
            v.append(qd)
            a.append(qdd)
            stiffness.append(s)
        return tuple(map(np.array, (x, v, a, stiffness)))

    return run


@pytest.fixture
def vary():
    """n policies near one; the stiffness rows move on their own scale."""

    def make(policy, n, size, stiffness):
        batch = policy.expand(n)
        generator = torch.Generator().manual_seed(9)
        with torch.no_grad():
            for name, p in batch.named_parameters():
                scale = stiffness if name.startswith("stiffness") else size
                p.add_(scale * torch.randn(p.shape, generator=generator, dtype=torch.float64))
        return batch

    return make
