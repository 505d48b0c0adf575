"""Figure 5: what noise on the parameters does to the velocity and to the motion (section 4.1)."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

import tasks
from torchds import plotting
from torchds.exploration import Exploration, Gaussian, Homogeneous, TrajectorySpace
from train.paper.figures.base import Made
from train.paper.measured.noise import perturbed, velocity_noise

N_SAMPLES = 40  # perturbed motions drawn in the lower row


@torch.no_grad()
def figure_5(runs: int, seed: int) -> Made:
    """Maps of the mean norm of the velocity noise, and motions under that noise."""
    task = tasks.make("via_point", shape="N")
    policy = task.policy()
    path = task.rollout(policy).x
    ones = {name: torch.ones_like(p) for name, p in policy.named_parameters()}
    homogeneous = Homogeneous(policy, mean_speed=1.0)
    along = TrajectorySpace.relative(policy, *task.motion())
    columns: list[tuple[str, Tensor, Exploration]] = [
        ("uniform", policy.join(ones).square().diag(), Gaussian(1.0)),
        ("homogeneous (section 4.1)", policy.join(homogeneous.std()).square().diag(), homogeneous),
        ("along the motion", along.covariance, along),
    ]
    figure = Figure(figsize=(16, 10.5), layout="constrained")
    grid = figure.subplots(2, 3)
    lines = []
    for (upper, lower), (title, covariance, exploration) in zip(grid.T, columns, strict=True):
        on_path = velocity_noise(policy, covariance, path[:-1])
        typical = float(on_path.median())
        desired = 1.0 if exploration is not along else typical
        share = float(((on_path - desired).abs() <= 0.5 * desired).double().mean())
        xlim, ylim = plotting.limits(path, *(d.x for d in task.demonstrations))
        xs, ys = np.linspace(*xlim, 60), np.linspace(*ylim, 60)
        points = torch.from_numpy(np.stack(np.meshgrid(xs, ys), -1))
        values = velocity_noise(policy, covariance, points) / desired
        image = upper.pcolormesh(xs, ys, values.numpy(), cmap="viridis", shading="gouraud", vmin=0, vmax=values.max())
        figure.colorbar(image, ax=upper, shrink=0.8, label="mean norm of the velocity noise / desired")
        plotting.gaussians(upper, policy)
        plotting.trajectories(upper, path, color="white", label="imitated motion")
        plotting.finish_map(upper, title, task.scene().unit)
        upper.set_xlim(*xlim)
        upper.set_ylim(*ylim)
        moved = perturbed(task, policy, exploration, 0.1 if exploration is not along else 1.0, N_SAMPLES, seed)
        offset = (moved - path).square().sum(-1).mean(0).sqrt()
        plotting.trajectories(
            lower, moved, color=plotting.AFTER, label=f"{N_SAMPLES} perturbed motions", lw=0.6, alpha=0.5
        )
        plotting.trajectories(lower, path, color="black", label="imitated motion")
        lower.set_xlim(xlim[0] - 3, xlim[1] + 3)
        lower.set_ylim(ylim[0] - 3, ylim[1] + 3)
        size = "a tenth of this noise" if exploration is not along else f"spread {float(along.spread[0]):.2g}"
        plotting.finish_map(lower, f"motions under {size}", task.scene().unit)
        lines.append(
            f"- {title}: velocity noise on the path {on_path.min():.2f} to {on_path.max():.2f} (median {typical:.2f}), within "
            f"50 % of {desired:.2f} on {100 * share:.1f} % of the path; displacement of the motion under {size}, root mean "
            f"square over {N_SAMPLES} samples, {offset[1:].min():.2g} to {offset[1:].max():.2g} along the way."
        )
    return Made(
        figure,
        "Above, the mean norm of the velocity noise over the state space of the N-shape, computed exactly: with variance one "
        "on every parameter it grows with the distance from the origin; with the rules of section 4.1 it is near the desired "
        "value around the Gaussians. Below, motions under such noise (with a tenth of it for the first two, the size that "
        "the learning runs use). The third column is the exploration along the motion, whose velocity noise is uneven so "
        "that the displacement of the motion is even; it has no desired speed, its map is relative to the median on the "
        "path.\n\n" + "\n".join(lines),
    )
