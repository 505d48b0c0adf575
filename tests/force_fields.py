"""What the released force fields are learned from in the tests, in place of the authors' demonstrations."""

import functools

import numpy as np
import torch

from torchds import Demonstrations, GaussianMixture


@functools.cache
def synthetic():
    """Three imperfect motions along the released program's path, slowing down at its end."""
    motions = []
    for i in range(3):
        s = 1 - (1 - np.linspace(0, 1, 110)) ** 1.4
        x = np.stack([-10 * (1 - s), np.sin(2 * np.pi * (1 - s))], -1)
        bump = np.stack([0.2 * (1 - s), 0.3 * np.sin(np.pi * s)], -1)
        motions.append(x + (i - 0.7) * bump)
    return Demonstrations(motions, dt=0.1)


def synthetic_mixture():
    """Two Gaussians along the way to the origin."""
    means = np.array([[-7.0, -0.6], [-2.0, 0.7]])
    slopes = np.array([[[-0.12, 0.2], [-0.1, -0.3]], [[-0.35, -0.2], [0.1, -0.4]]])
    inputs = np.array([[[4.0, 0.3], [0.3, 0.8]], [[2.5, -0.4], [-0.4, 0.6]]])
    velocities = np.einsum("kij,kj->ki", slopes, means) + np.array([[0.1, 0.2], [0.1, 0.1]])
    cross = slopes @ inputs
    covariances = np.block([[inputs, cross.swapaxes(1, 2)], [cross, cross @ slopes.swapaxes(1, 2) + 0.01 * np.eye(2)]])
    centres = np.concatenate([means, velocities], -1)
    return GaussianMixture(*(torch.tensor(value) for value in (np.array([0.5, 0.5]), centres, covariances)))
