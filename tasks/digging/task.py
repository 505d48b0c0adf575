"""The digging task: as much gravel as possible on the shovel, with little force and a soft arm (section 6)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tasks.digging import lwr
from tasks.digging.demonstrate import FOLDER
from tasks.digging.gravel import COARSE, Gravel
from tasks.digging.simulation import Recording, dig
from tasks.digging.worlds import Worlds
from tasks.imitation import with_stiffness
from tasks.lwr_digging import HIGH, LOW, SECONDS, DiggingOptions
from tasks.settings import PAPER_FLOOR, Motion, Scene
from torchds import Demonstrations, GaussianMixture, GMRPolicy, Rollout, load_csv, rollout, sharing
from torchds.errors import InvalidArgumentError

BEDS = {"fine": Gravel(), "coarse": COARSE}
N_COMPONENTS = 4
TARE = 3.5  # N, the constant in the gravel's term
GOAL_WEIGHT, FORCE_WEIGHT, STIFFNESS_WEIGHT, ACCELERATION_WEIGHT = 10.0, 1e-6, 5e-7, 1e-4
COST_STEP = 0.002  # s
LIFTED = 0.16  # m, height of the tool point above which the blade is out of the bed for good


class LwrDigging(DiggingOptions):
    """A KUKA LWR shovels gravel out of a box within 15 s, under a Cartesian impedance controller with learned stiffness.

    The policy sees the position of its own reference and gives velocity, angular rate and one stiffness (Eq. 36); both
    are integrated to the reference (Eq. 37-38) that the controller tracks at 250 Hz. The cost of a trial is (Eq. 35)

        (3.5 − w) + 10 |ξ^goal − ξ_T|² + Σ_t (10⁻⁶ |F̃_t|² + 5·10⁻⁷ s_t + 10⁻⁴ |ξ̇_t − ξ̇_{t−1}|²)

    with ξ = (x₁, x₂, φ) [m, m, rad] as measured and a control cost of r = 10⁻¹². Where the paper is silent or does not say
    what it means:

    * As printed, (f − 3.5) with f along negative x₂, the weight, would be least for an empty shovel; 3.5 − w rewards w, the
      weight of the gravel in the last 0.5 s.
    * N_t is not given and decides between force, stiffness and gravel: the sums run at 500 Hz, the rate of the authors'
      robot, so that each of the 250 Hz steps counts twice.
    * F̃ is the force between gripper and shovel less the weight of the empty shovel, and less w from when the blade has
      left the bed for good (tool point above 0.16 m): while it is in the bed, nobody can tell what it carries.
    * A factor of ten between the stiffnesses is s/10 N m/rad about the normal of the plane (see `CartesianImpedance`).
    * The stiffness is applied, and costs, within [50, 700] N/m, as on the authors' robot.
    * ξ^goal is the mean end of the demonstrations, and the start their mean start.

    A trial fails, with infinite cost, where the simulation explodes or loses a grain, and where the reference leaves what
    the arm reaches; the arm then stays where it is. Each trial has a bed of its own, whose grains are moved by 0.1 mm;
    `trials` counts them, so that a run that is resumed meets the same beds.

    Raises:
        InvalidArgumentError: see `DiggingOptions`; demonstrations that do not have three dimensions, or a start out of reach.
    """

    name = "lwr_digging"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.gravel = BEDS[self.grains]
        self.dt = self.gravel.time_step
        self.trials = 0
        self.progress: Callable[[float], object] | None = None
        if self.demonstrations.dim != 3:
            raise InvalidArgumentError(
                "demonstrations of digging have to have three dimensions, x and z [m] and the angle [rad], got "
                f"{self.demonstrations.dim}: {', '.join(self.demonstrations.names)}"
            )
        self.start = torch.stack([d.x[0] for d in self.demonstrations]).mean(0).to(torch.float64)
        self.goal = torch.stack([d.x[-1] for d in self.demonstrations]).mean(0).to(torch.float64)
        lwr.posture(*self.start)
        self._worlds: dict[int, Worlds] = {}

    # ------------------------------------------------------------------ policy

    def default_demonstrations(self) -> Demonstrations:
        """Five motions in soil of 12.5 to 14.5 s (see `tasks.digging.demonstrate`), faster for a shorter task."""
        soil = load_csv(FOLDER, positions=("x", "z", "angle"), units=("m", "m", "rad"))
        faster = [dt * self.seconds / SECONDS for dt in soil.dt]
        return Demonstrations([d.x for d in soil], dt=faster, names=soil.names, units=soil.units)

    def fit(self, demonstrations: Demonstrations) -> GaussianMixture:
        """Four Gaussians over position, velocity and angular rate."""
        return GaussianMixture.fit(demonstrations, N_COMPONENTS, input_dim=2, covariance_floor=PAPER_FLOOR)

    def policy(self) -> GMRPolicy:
        """The imitated motion with the stiffness that was demonstrated, or else the uniform s⁰."""
        return with_stiffness(self.mixture, 2, 3, 1, self.initial_stiffness)

    def motion(self) -> Motion:
        """The motion from the one start."""
        return Motion(self.start[:2], round(self.seconds / self.dt), self.dt)

    # ------------------------------------------------------------------ a trial

    @torch.no_grad()
    def reference(self, policy: GMRPolicy) -> tuple[Rollout, Tensor, Tensor]:
        """What the controller is asked for, from the policy alone (Eq. 36-38).

        Returns:
            The roll-out of the policy; poses `(*batch, T+1, 3)`: x, z [m], angle [rad]; stiffness `(*batch, T)` within
            its bounds [N/m].
        """
        path = rollout(policy, *self.motion())
        turned = torch.cat([path.v.new_zeros(path.v[..., :1, 2].shape), path.v[..., 2].cumsum(-1)], -1)
        angle = self.start[2] + self.dt * turned
        assert path.stiffness is not None
        return path, torch.cat([path.x, angle.unsqueeze(-1)], -1), path.stiffness[..., 0].clamp(LOW, HIGH)

    def rollout(self, policy: GMRPolicy) -> Rollout:
        """One trial of each policy, on a new bed each; `plant` of the result is its `Recording`."""
        path, reference, stiffness = self.reference(policy)
        recording = self.execute(reference, stiffness)
        return replace(path, x=recording.pose, v=recording.pose.diff(dim=-2) / self.dt, plant=recording)

    @torch.no_grad()
    def execute(self, reference: Tensor, stiffness: Tensor) -> Recording:
        """Let the arm follow references, on a new bed each.

        Args:
            reference: `(*batch, T+1, 3)` as `reference` gives them.
            stiffness: `(*batch, T)` [N/m].

        Returns:
            The recording, `*batch` in front of each field.
        """
        batch = stiffness.shape[:-1]
        reference, stiffness = reference.reshape(-1, *reference.shape[-2:]), stiffness.reshape(-1, stiffness.shape[-1])
        possible = lwr.reaches(*reference.unbind(-1)).all(-1) & stiffness.isfinite().all(-1)
        stay = torch.where(possible[:, None, None], reference, self.start)
        soft = torch.where(possible[:, None], stiffness, LOW)
        # Beds of one seed do not meet those of another for the first million trials.
        first = self.seed * 1_000_000 + self.trials
        seeds = sharing.drawn(tuple(batch), lambda all_: first + torch.arange(math.prod(all_)).reshape(all_))
        self.trials += math.prod(sharing.whole(tuple(batch)))
        done = dig(self.worlds(len(stay)), stay, soft, seeds.flatten().tolist(), self.progress)
        done = done._replace(failed=done.failed | ~possible)
        # `dig` works in inference mode; its copies are tensors like any other
        return Recording(*(value.clone().reshape(batch + value.shape[1:]) for value in done))

    def worlds(self, n: int) -> Worlds:
        """The worlds of `n` roll-outs at once, made when they are first needed."""
        if n not in self._worlds:
            self._worlds[n] = Worlds(self.gravel, n, min(self.threads, n))
        return self._worlds[n]

    # ------------------------------------------------------------------ what it costs

    def cost_terms(self, path: Rollout) -> dict[str, Tensor]:
        """Gravel, goal, force, stiffness and acceleration of Eq. 35; infinite where the trial failed."""
        done: Recording = path.plant
        running = {name: steps.sum(-1) for name, steps in self.running_costs(path).items()}
        gravel = torch.where(done.failed, torch.inf, TARE - done.load)
        goal = GOAL_WEIGHT * (done.pose[..., -1, :] - self.goal).square().sum(-1)
        return {"gravel": gravel, "goal": goal, **running}

    def running_costs(self, path: Rollout) -> dict[str, Tensor]:
        """The terms of force, stiffness and acceleration by steps."""
        done: Recording = path.plant
        per_step = self.dt / COST_STEP
        # Over shorter steps the velocity changes by a part of this, and more often.
        change = torch.nn.functional.pad(path.v.diff(dim=-2), (0, 0, 1, 0)).square().sum(-1) / per_step
        running = {
            "force": per_step * FORCE_WEIGHT * self.force(done).square().sum(-1),
            "stiffness": per_step * STIFFNESS_WEIGHT * done.stiffness,
            "acceleration": ACCELERATION_WEIGHT * change,
        }
        return {name: torch.where(done.failed.unsqueeze(-1), 0.0, steps) for name, steps in running.items()}

    @staticmethod
    def force(done: Recording) -> Tensor:
        """F̃ `(*batch, T, 3)` [N]: without the weight of the gravel once the blade is out of the bed."""
        low = done.pose[..., 1:, 1] < LIFTED
        out = low.flip(-1).cumsum(-1).flip(-1) == 0  # and stays out
        force = done.force.clone()
        force[..., 2] -= torch.where(out, done.load.unsqueeze(-1), 0.0)
        return force

    def diagnostics(self, path: Rollout) -> dict[str, Tensor]:
        """Load, forces, stiffness and depth of a trial, `(*batch)`."""
        done: Recording = path.plant
        force = self.force(done).norm(dim=-1)
        return {
            "gravel/load": done.load,
            "force/mean": force.mean(-1),
            "force/peak": force.amax(-1),
            "stiffness/mean": done.stiffness.mean(-1),
            "stiffness/min": done.stiffness.amin(-1),
            "stiffness/max": done.stiffness.amax(-1),
            "motion/lowest": done.pose[..., 1].amin(-1),
        }

    def film(self, path: Rollout, frames: int) -> np.ndarray:
        """Arm, shovel and gravel.

        Raises:
            NoRendererError: there is no OpenGL here.
        """
        from tasks.digging.rendering import render  # looks for OpenGL, so only where pictures are wanted

        done: Recording = path.plant
        snapshots = done.snapshots.reshape(-1, *done.snapshots.shape[-2:])[0]
        last = len(snapshots) - 1
        chosen = torch.linspace(0, last, frames).round().long() if frames > 1 else torch.tensor([last])
        return render(self.gravel, snapshots[chosen])

    def scene(self) -> Scene:
        """Start and goal in the plane, and the walls of the box."""
        low, high = self.gravel.box
        walls = torch.tensor([[[low, 0.0], [low, 0.2]], [[high, 0.0], [high, 0.2]], [[low, 0.0], [high, 0.0]]])
        return Scene(self.start[None, :2], self.goal[:2], unit="m", walls=walls.to(torch.float64))

    # ------------------------------------------------------------------ books

    @property
    def wall_seconds(self) -> dict[str, float]:
        """Wall time of all trials so far: "control" for kinematics, impedance law and bookkeeping, "physics" for MuJoCo [s]."""
        spent = [worlds.seconds for worlds in self._worlds.values()]
        return {name: sum(s[name] for s in spent) for name in ("control", "physics")}

    def state_dict(self) -> dict[str, Any]:
        """How many trials there were, which decides about the next bed."""
        return {"trials": self.trials}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue with the bed that comes next."""
        self.trials = int(state["trials"])
