"""Fused roll-outs beside eager ones."""

import pytest
import torch

from torchds import kernels, rollout

needs_numba = pytest.mark.skipif(not kernels.available()["cpu"], reason="needs numba")
T, DT = 60, 0.03


def close(a, b, rtol=1e-12):
    """The same but for round-off, relative to the largest number in each field; NaN and infinity where the other has them."""
    for name in ("x", "v", "features", "resting", "stiffness", "reference", "inputs"):
        p, q = getattr(a, name), getattr(b, name)
        assert (p is None) == (q is None), name
        if p is None:
            continue
        assert p.shape == q.shape and p.dtype == q.dtype, name
        if p.dtype == torch.bool:
            assert torch.equal(p, q), name
        elif q.numel():
            size = q[q.isfinite()].abs().amax() if q.isfinite().any() else 1.0
            torch.testing.assert_close(
                p, q, rtol=rtol, atol=rtol * float(size), equal_nan=True, msg=lambda m, n=name: f"{n}: {m}"
            )
    assert (a.plant is None) == (b.plant is None)
    if a.plant is not None:
        assert type(a.plant) is type(b.plant)
        for name, p, q in zip(a.plant._fields, a.plant, b.plant, strict=True):
            torch.testing.assert_close(
                p, q, rtol=rtol, atol=rtol * max(1.0, float(q.abs().amax())), msg=lambda m, n=name: f"plant.{n}: {m}"
            )


@torch.no_grad()
def both(policy, x0, n_steps=T, dt=DT, rtol=1e-12, **options):
    fused = rollout(policy, x0, n_steps, dt, backend="fused", **options)
    close(fused, rollout(policy, x0, n_steps, dt, backend="eager", **options), rtol)
    return fused
