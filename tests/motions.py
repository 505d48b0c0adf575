"""Small motions and checks that the tests of demonstrations and of their files share."""

import re

import numpy as np
import pytest
import torch

import tasks
from torchds.demonstrations import Demonstrations


def sine(n_samples=101, duration=2.0, phase=0.0):
    """x = (sin, t^2) and its exact velocity, with the time step."""
    t = np.linspace(0, duration, n_samples)
    x = np.stack([np.sin(t + phase), t**2], -1)
    return x, np.stack([np.cos(t + phase), 2 * t], -1), duration / (n_samples - 1)


def two(stiffness=False, **kwargs):
    """Two motions of different length and time step."""
    (xa, va, dta), (xb, vb, dtb) = sine(101), sine(61, 3.0, 0.5)
    k = [xa[:, :1] ** 2 + 1, xb[:, :1] ** 2 + 2] if stiffness else None
    return Demonstrations([xa, xb], [va, vb], [dta, dtb], stiffness=k, **kwargs)


def equal(a, b):
    assert len(a) == len(b) and a.names == b.names and a.units == b.units
    for p, q in zip(a, b, strict=True):
        assert p.dt == q.dt and torch.equal(p.x, q.x) and torch.equal(p.v, q.v) and p.x.dtype == q.x.dtype
        assert (p.stiffness is None) == (q.stiffness is None)
        assert p.stiffness is None or torch.equal(p.stiffness, q.stiffness)
    return True


def refuses(kind, *words):
    return pytest.raises(kind, match=".*".join(re.escape(word) for word in words))


class Short(tasks.ViaPoint):
    """A letter in a tenth of the steps."""

    def motion(self):
        motion = super().motion()
        return motion._replace(n_steps=motion.n_steps // 10, dt=10 * motion.dt)
