"""torchds: learn robot motions from demonstrations and rewards.

Demonstrations become a Gaussian mixture, the mixture becomes a time-invariant dynamical system with a frozen gating
(`GMRPolicy`), and policy search improves it by trial:

    demonstrations ──fit──▶ mixture ──condition──▶ GMRPolicy ──rollout──▶ Rollout ──cost terms──▶ cost (N,)
                                                       ▲                                             │
                                                       └──────────── PIBB.step(closure) ◀────────────┘
                                                                          ▲
                                                                     exploration

Axes, in all docstrings: `*batch` policies, `N` roll-outs (parameter samples), `S` starts, `K` components, `D` inputs, `O`
velocity outputs, `Q` stiffness outputs, `T` steps, `P` flattened parameters, `F` = K (D+1) features. Time is axis -2, the
vector axis -1, batches lead. A policy has a `batch_shape` (that of `A`, in front of `K, O, D`); a state has shape
`(*batch_shape, *points, D)`. While `PIBB` evaluates, every parameter carries an extra leading `N`.

Stability: stable.

Example:
    >>> import torch, torchds
    >>> demos = torchds.load_lasa("NShape", n_demos=3, duration=12.0)
    >>> policy = torchds.GMRPolicy.from_demonstrations(demos.every(5), n_components=4)
    >>> noise = torchds.exploration.Homogeneous(policy, mean_speed=2.0)
    >>> optim = torchds.optim.PIBB(policy.parameters(), exploration=noise, n_rollouts=10)
    >>> target = torch.tensor([-20.0, -10.0], dtype=torch.float64)
    >>> def closure():
    ...     path = torchds.rollout(policy, demos[0].x[0], n_steps=120, dt=0.1)
    ...     return torchds.costs.via_points(path.x, target[None])
    >>> costs = [float(optim.step(closure)) for _ in range(10)]
    >>> costs[-1] < costs[0]
    True
"""

from typing import Any

from torchds import errors as errors
from torchds.control import Controller as Controller

try:
    import torch as _torch  # noqa: F401
except ModuleNotFoundError as _missing:  # the computer of a robot: the controller needs numpy alone
    if _missing.name != "torch":
        raise

    def __getattr__(name: str) -> Any:
        raise AttributeError(
            f"torchds.{name} needs torch, which is not installed; without it there are torchds.Controller and torchds.control"
        )

else:
    from torchds import costs as costs
    from torchds import exploration as exploration
    from torchds import impedance as impedance
    from torchds import metrics as metrics
    from torchds import monitor as monitor
    from torchds import optim as optim
    from torchds import passive as passive
    from torchds import plants as plants
    from torchds import poses as poses
    from torchds import sessions as sessions
    from torchds import stability as stability
    from torchds import visits as visits
    from torchds.demonstrations import Demonstration as Demonstration
    from torchds.demonstrations import Demonstrations as Demonstrations
    from torchds.exporting import export as export
    from torchds.fits import StableFit as StableFit
    from torchds.fits import fit_stable as fit_stable
    from torchds.mixture import Conditional as Conditional
    from torchds.mixture import GaussianMixture as GaussianMixture
    from torchds.policy import GMRPolicy as GMRPolicy
    from torchds.recordings import load as load
    from torchds.recordings import load_csv as load_csv
    from torchds.recordings import load_lasa as load_lasa
    from torchds.recordings import load_mat as load_mat
    from torchds.recordings import load_npz as load_npz
    from torchds.recruiting import most_wanted as most_wanted
    from torchds.recruiting import recruit as recruit
    from torchds.rollouts import Rollout as Rollout
    from torchds.rollouts import rollout as rollout
    from torchds.saving import load_policy as load_policy
    from torchds.starts import fit_mixtures as fit_mixtures
    from torchds.stops import Bounds as Bounds
    from torchds.stops import Walls as Walls

__version__ = "0.2.0"

__all__ = [
    "Bounds",
    "Conditional",
    "Controller",
    "Demonstration",
    "Demonstrations",
    "GMRPolicy",
    "GaussianMixture",
    "Rollout",
    "StableFit",
    "Walls",
    "costs",
    "errors",
    "exploration",
    "export",
    "fit_mixtures",
    "fit_stable",
    "impedance",
    "load",
    "load_csv",
    "load_lasa",
    "load_mat",
    "load_npz",
    "load_policy",
    "metrics",
    "monitor",
    "most_wanted",
    "optim",
    "passive",
    "plants",
    "poses",
    "recruit",
    "rollout",
    "sessions",
    "stability",
    "visits",
]
