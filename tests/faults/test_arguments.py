"""What takes tensors takes the same numbers as arrays and lists, with equal results, and refuses what is none in our words."""

import dataclasses
import importlib
import inspect
import pkgutil
import re
import tempfile

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from torch import nn

import torchds
from tests.faults.test_optimizer import make_policy
from torchds import costs, metrics, plotting, poses, stability
from torchds.cartesian import CartesianImpedance
from torchds.errors import MissingPackageError, TorchdsError
from torchds.exploration import Gaussian, Homogeneous, Stable, TrajectorySpace
from torchds.exploration.trajectory import Coordinates
from torchds.forces import ConstantForce, DivergentForce, SpringForce
from torchds.impedance import ImpedanceControlled
from torchds.mixture import joint_samples
from torchds.optim import functional
from torchds.optim.regression import Regression
from torchds.plants import PointMass
from torchds.sensitivity import sensitivity, stiffness_sensitivity
from torchds.stops import Walls
from torchds.targets import PlaneReference

T, DT = 5, 0.1


def randn(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


POLICY, STIFF = make_policy(), make_policy(Q=1)
X0, PATH, V = randn(2), randn(3, T, 2, seed=1), randn(3, T, 2, seed=2)
P = torch.tensor([[2.0, 0.3], [0.3, 1.0]], dtype=torch.float64)
SLOPES = torch.tensor([[-1.0, 0.4], [-0.2, -2.0]], dtype=torch.float64).repeat(2, 1, 1)
GOAL = torch.tensor([0.3, -0.2], dtype=torch.float64)
GATE = POLICY.priors, POLICY.means, POLICY.covariances
MIXTURE = torchds.GaussianMixture(POLICY.priors, randn(2, 4), torch.eye(4, dtype=torch.float64).repeat(2, 1, 1))
DEMOS = torchds.Demonstrations(
    [torch.stack([torch.linspace(1, 0, 9) ** 2, torch.linspace(0, 1, 9)], -1).double()], dt=0.1
)
TURNING = nn.functional.normalize(
    torch.stack([torch.ones(9), *(k * torch.linspace(1, 0, 9) for k in (1, 2, 3))], -1).double()
)
MOTION = torchds.rollout(STIFF, X0, T, DT)
START = torchds.fit_mixtures(DEMOS, 1, goal=GOAL)
REGRESSION = Regression(randn(6, 3), randn(6))


class OneJoint:
    """An arm of one joint about the normal of the plane xy, one metre long."""

    dtype = torch.float64

    def jacobian(self, th, *, ret_eef_pose):
        c, s, zero, one = th[:, 0].cos(), th[:, 0].sin(), torch.zeros_like(th[:, 0]), torch.ones_like(th[:, 0])
        J = torch.stack([-s, c, zero, zero, zero, one], -1).unsqueeze(-1)
        rows = [[c, -s, zero, c], [s, c, zero, s], [zero, zero, one, zero], [zero, zero, zero, one]]
        return J, torch.stack([torch.stack(row, -1) for row in rows], -2)


def stable_policy():
    return torchds.GMRPolicy(*GATE, SLOPES, -(SLOPES @ GOAL))


STABLE, LINEAR = stable_policy(), nn.Linear(1, 1, dtype=torch.float64)


def drawn(draw, three=False):
    """The points of all lines that were drawn into new axes."""
    axes = Figure().add_subplot(projection="3d" if three else None)
    draw(axes)
    return [torch.tensor(np.stack(line.get_data_3d() if three else line.get_data())) for line in axes.lines]


def explored(noise, policy):
    """What an exploration makes of fixed normals."""
    parameters = list(policy.parameters())
    noise.check(parameters)
    return noise(parameters, [randn(4, *p.shape, seed=i) for i, p in enumerate(parameters)])


def constrained(**given):
    return stability.constrain(stable_policy(), **given, margin=0.1)


def pushed(force):
    return torchds.rollout(POLICY, X0, T, DT, plant=ImpedanceControlled(PointMass(force=force), 20.0))


def arm(**given):
    state = {"q": randn(4, 1), "v": randn(4, 1), "mass": torch.ones(4, 1, 1).double(), "bias": randn(4, 1)}
    reference = PlaneReference(randn(4, 2), randn(4), randn(4, 2), randn(4))
    made = {"posture": [0.1], "torque_limit": None} | {
        n: given.pop(n) for n in ("posture", "torque_limit") if n in given
    }
    state["stiffness"] = torch.full((4,), 20.0)
    return CartesianImpedance(OneJoint(), **made, plane="xy", start_within=None)(
        **(state | given | {"reference": reference})
    )


def aligned(q):
    zero = torch.zeros(2, dtype=torch.float64)
    return CartesianImpedance(OneJoint(), [0.1], plane="xy").aligned(q, PlaneReference(zero, zero[0], zero, zero[0]))


def pendulum():
    joint = '<body name="link"><joint axis="0 1 0"/><geom size=".1" pos="0 0 -1"/></body>'
    return torchds.impedance.arm(f"<mujoco><worldbody>{joint}</worldbody></mujoco>")


PLANE = torchds.sessions.Layout(("x [m]", "y [m]"))


def saved(**given):
    """What a file says of goal and P."""
    with tempfile.TemporaryDirectory() as folder:
        stable_policy().save(f"{folder}/policy.pt", **given)
        info = torchds.load_policy(f"{folder}/policy.pt").info
        return [info.goal, info.P]


def controlled(change):
    controller = torchds.Controller(POLICY, DT)
    controller.reset(GOAL)
    change(controller)
    return controller.step().x.copy()


def unpacked(theta):
    return make_policy().unpack(theta)


# What is called, and the arguments that are tensors; "any" names those whose last axis may have any length.
CASES = {
    "costs.via_points": (costs.via_points, {"x": PATH, "points": randn(4, 2)}),
    "costs.goal": (costs.goal, {"x": PATH, "target": GOAL}),
    "costs.intrusion": (costs.intrusion, {"x": PATH, "centres": randn(4, 2), "radii": randn(4).abs()}),
    "costs.acceleration_steps": (costs.acceleration_steps, {"v": V}),
    "costs.acceleration": (costs.acceleration, {"v": V}),
    "costs.path_length": (lambda v: costs.path_length(v, DT), {"v": V}),
    "costs.stiffness": (costs.stiffness, {"s": V}),
    "costs.control_cost": (
        costs.control_cost,
        {
            "deviation": randn(3, 2, 6),
            "noise": randn(3, 2, 6),
            "features": randn(3, T, 6),
            "weight": randn(3, 2, 6) ** 2,
        },
    ),
    "metrics.velocity_rmse": (metrics.velocity_rmse, {"v": V, "demonstrated": PATH}),
    "metrics.direction_error": (metrics.direction_error, {"v": V, "demonstrated": PATH}),
    "metrics.swept_area": (metrics.swept_area, {"x": PATH, "demonstrated": V[0]}),
    "metrics.dtwd": (metrics.dtwd, {"x": PATH, "demonstrated": V[0]}),
    "stability.certificate": (lambda **given: stability.certificate(POLICY, **given), {"goal": GOAL, "P": P}),
    "stability.resolution": (stability.resolution, {"A": SLOPES, "P": P}),
    "stability.largest_eigenvalue": (stability.largest_eigenvalue, {"A": SLOPES, "P": P}),
    "stability.stable_matrices": (stability.stable_matrices, {"factor": SLOPES, "skew": randn(2, 2, 2), "P": P}),
    "stability.stable_factors": (stability.stable_factors, {"A": SLOPES, "P": P}),
    "stability.project": (stability.project, {"A": randn(2, 2, 2), "P": P, "margin": randn(2) ** 2}),
    "stability.constrain": (constrained, {"goal": GOAL, "P": P}),
    "mixture.GaussianMixture": (
        torchds.GaussianMixture,
        {"priors": MIXTURE.priors, "means": MIXTURE.means, "covariances": MIXTURE.covariances},
    ),
    "mixture.GaussianMixture.component_log_prob": (MIXTURE.component_log_prob, {"y": randn(3, 4)}),
    "mixture.GaussianMixture.log_prob": (MIXTURE.log_prob, {"y": randn(3, 4)}),
    "mixture.GaussianMixture.condition": (MIXTURE.condition, {"x": randn(3, 2)}),
    "mixture.GaussianMixture.fit": (lambda data: torchds.GaussianMixture.fit(data, 1), {"data": randn(20, 2)}),
    "mixture.joint_samples": (joint_samples, {"data": randn(20, 2)}),
    "parameters.ExpertParameters.split": (POLICY.split, {"theta": POLICY.pack().detach()}),
    "parameters.ExpertParameters.unpack": (unpacked, {"theta": randn(3, 12)}),
    "parameters.ExpertParameters.save": (saved, {"goal": GOAL, "P": P}),
    "policy.GMRPolicy": (
        torchds.GMRPolicy,
        {"priors": GATE[0], "means": GATE[1], "covariances": GATE[2], "A": SLOPES, "b": randn(2, 2)}
        | {"stiffness_A": randn(2, 1, 2), "stiffness_b": randn(2, 1)},
    ),
    "policy.GMRPolicy.from_mixture": (
        lambda stiffness: torchds.GMRPolicy.from_mixture(MIXTURE, 2, 2, stiffness),
        {"stiffness": GOAL + 9},
    ),
    "policy.GMRPolicy.from_demonstrations": (
        lambda stiffness: torchds.GMRPolicy.from_demonstrations(DEMOS, 1, stiffness=stiffness, stiffness_dim=2),
        {"stiffness": GOAL + 9},
    ),
    "policy.GMRPolicy.gating": (POLICY.gating, {"x": X0}),
    "policy.GMRPolicy.features": (POLICY.features, {"x": X0}),
    "policy.GMRPolicy.forward": (POLICY, {"x": X0}),
    "policy.GMRPolicy.stiffness": (STIFF.stiffness, {"x": X0}),
    "policy.GMRPolicy.basis": (POLICY.basis, {"x": X0}),
    "policy.GMRPolicy.jacobian": (POLICY.jacobian, {"x": X0}),
    "policy.GMRPolicy.certificate": (POLICY.certificate, {"goal": GOAL, "P": P}),
    "rollouts.rollout": (lambda x0: torchds.rollout(POLICY, x0, T, DT), {"x0": randn(3, 2)}),
    "stops.Bounds": (
        lambda **given: torchds.rollout(POLICY, X0, T, DT, stop=torchds.Bounds(**given)),
        {"low": X0 - 0.1, "high": X0 + 0.1},
    ),
    "stops.Walls": (
        lambda segments: torchds.rollout(POLICY, X0, T, DT, stop=Walls(segments)),
        {"segments": X0 + randn(3, 2, 2)},
    ),
    "sensitivity.stiffness_sensitivity": (
        lambda J: stiffness_sensitivity(STIFF, MOTION, J),
        {"J": sensitivity(STIFF, MOTION)},
    ),
    "recruiting.recruit": (lambda at: torchds.recruit(POLICY, at, 0.5), {"at": X0}),
    "plants.PointMass": (lambda force: pushed(lambda t, x, v: force), {"force": GOAL}),
    "forces.ConstantForce": (lambda force: pushed(ConstantForce(force)), {"force": GOAL}),
    "forces.SpringForce": (lambda anchor: pushed(SpringForce(anchor, 5.0)), {"anchor": GOAL}),
    "forces.DivergentForce": (lambda path: pushed(DivergentForce(path, 2.0)), {"path": randn(4, 2)}),
    "impedance.ImpedanceControlled": (
        lambda stiffness: torchds.rollout(POLICY, X0, T, DT, plant=ImpedanceControlled(PointMass(), stiffness)),
        {"stiffness": GOAL + 9},
    ),
    "cartesian.CartesianImpedance": (arm, {"posture": randn(1), "torque_limit": randn(1) ** 2}),
    "cartesian.CartesianImpedance.__call__": (
        arm,
        {"q": randn(4, 1), "v": randn(4, 1), "mass": torch.ones(4, 1, 1).double(), "bias": randn(4, 1)}
        | {"stiffness": randn(4) ** 2},
    ),
    "cartesian.CartesianImpedance.aligned": (aligned, {"q": randn(1)}),
    "arms.Arm.dynamics": (
        lambda **given: list(pendulum().dynamics(**given)),
        {"q": randn(1, 1), "v": randn(1, 1)},
    ),
    "arms.Arm.impedance": (lambda posture: pendulum().impedance(posture).posture, {"posture": randn(1)}),
    "exploration.gaussian.Gaussian": (
        lambda std: explored(Gaussian(std), nn.Linear(1, 1, dtype=torch.float64)),
        {"std": GOAL**2},
    ),
    "exploration.gaussian.Gaussian.relative": (
        lambda **given: explored(Gaussian.relative(POLICY, n_steps=T, dt=DT, **given), POLICY),
        {"x0": X0, "goal": GOAL},
    ),
    "exploration.homogeneous.Homogeneous": (
        lambda direction: explored(Homogeneous(POLICY, direction=direction), POLICY),
        {"direction": GOAL**2},
    ),
    "exploration.homogeneous.Homogeneous.relative": (
        lambda x0: explored(Homogeneous.relative(POLICY, x0, T, DT), POLICY),
        {"x0": X0},
    ),
    "exploration.stable.Stable": (
        lambda **given: explored(Stable(STABLE, Gaussian(0.5), **given), STABLE),
        {"goal": GOAL, "P": P},
    ),
    "exploration.stable.Stable.shrinkage": (
        Stable.shrinkage,
        {"A": SLOPES, "S_noise": randn(2, 2, 2), "P": P, "margin": torch.tensor([0.1, 0.2]).double()},
    ),
    "exploration.trajectory.TrajectorySpace": (
        lambda **given: explored(TrajectorySpace(POLICY, n_steps=T, dt=DT, **given), POLICY),
        {"x0": X0, "spread": GOAL**2, "goal": GOAL},
    ),
    "exploration.trajectory.TrajectorySpace.relative": (
        lambda **given: explored(TrajectorySpace.relative(POLICY, n_steps=T, dt=DT, **given), POLICY),
        {"x0": X0, "goal": GOAL},
    ),
    "exploration.trajectory.Coordinates.theta": (Coordinates(randn(3), randn(3, 3)).theta, {"z": randn(3)}),
    "optim.functional.cost_weights": (functional.cost_weights, {"costs": randn(4, 2)}),
    "optim.functional.relative_costs": (functional.relative_costs, {"costs": randn(4, 2)}),
    "optim.functional.informative": (functional.informative, {"costs": randn(4, 2)}),
    "optim.regression.Regression": (
        lambda **given: Regression(**given).predict(randn(4, 3)),
        {"tried": randn(6, 3), "costs": randn(6)},
    ),
    "optim.regression.Regression.predict": (REGRESSION.predict, {"candidates": randn(4, 3)}),
    "optim.regression.Regression.standard_error": (REGRESSION.standard_error, {"candidates": randn(4, 3)}),
    "optim.functional.cost_to_go": (functional.cost_to_go, {"costs": randn(4, T), "upsilon": randn(4, T)}),
    "optim.functional.time_averaged_update": (
        functional.time_averaged_update,
        {"weights": randn(4, T), "noise": randn(4, 2, 6), "features": randn(4, T, 6), "gating": randn(4, T, 6) ** 2}
        | {"free": torch.ones(2, 6).double()},
    ),
    "fits.fit_stable": (
        lambda goal: torchds.fit_stable(DEMOS, 1, goal=goal, start=START, condition="seds", n_steps=10),
        {"goal": GOAL},
    ),
    "plotting.limits": (lambda tracks: torch.tensor(plotting.limits(tracks)), {"tracks": PATH}),
    "plotting.small_map": (lambda tracks: torch.tensor(plotting.small_map(tracks)[1].axis()), {"tracks": PATH}),
    "plotting.shown": (lambda x: plotting.shown(Figure().add_subplot(), "x", x), {"x": PATH}),
    "plotting.trajectories": (
        lambda x: drawn(lambda axes: plotting.trajectories(axes, x, color="red", label="x")),
        {"x": PATH},
    ),
    "plotting.markers": (
        lambda starts, goal: drawn(lambda axes: plotting.markers(axes, starts, goal, {})),
        {"starts": PATH[0], "goal": GOAL},
    ),
    "plotting.frames": (
        lambda x, goal: drawn(lambda axes: plotting.frames(axes, x, goal, size=0.1), three=True),
        {"x": 0.1 * randn(T, 6), "goal": TURNING[0]},
    ),
    "plotting.discs": (
        lambda **given: drawn(lambda axes: plotting.discs(axes, **given)),
        {"centres": PATH[:, 0], "radii": randn(3).abs()},
    ),
    "plotting.walls": (lambda segments: drawn(lambda axes: plotting.walls(axes, segments)), {"segments": PATH[:, :2]}),
    "starts.fit_mixtures": (lambda goal: torchds.fit_mixtures(DEMOS, 1, goal=goal), {"goal": GOAL}),
    "demonstrations.Demonstrations": (
        lambda **given: list(torchds.Demonstrations(**{name: [value] for name, value in given.items()}, dt=0.1)),
        {"x": DEMOS[0].x, "v": DEMOS[0].v, "stiffness": DEMOS[0].v + 9},
    ),
    "mending.Mending.from_samples": (
        lambda **given: list(torchds.Demonstrations.from_samples(**{name: [value] for name, value in given.items()})),
        {"times": DT * torch.arange(9).double(), "positions": DEMOS[0].x, "velocities": DEMOS[0].v},
    ),
    "poses.rotation_vector": (poses.rotation_vector, {"quaternion": randn(3, 4), "goal": randn(4, seed=3)}),
    "poses.quaternion": (poses.quaternion, {"x": randn(3, 6), "goal": randn(4)}),
    "poses.matrix": (poses.matrix, {"x": randn(3, 6), "goal": randn(4)}),
    "poses.angular_velocity": (poses.angular_velocity, {"x": randn(3, 6), "v": randn(3, 6, seed=3), "goal": randn(4)}),
    "poses.last_orientation": (lambda quaternion: poses.last_orientation([quaternion]), {"quaternion": TURNING}),
    "poses.from_poses": (
        lambda position, quaternion, goal: list(poses.from_poses([position], [quaternion], 0.1, goal)),
        {"position": randn(9, 3), "quaternion": TURNING, "goal": TURNING[-1]},
    ),
    "control.controller.Controller": (
        lambda low, high: torchds.Controller(POLICY, DT, workspace=(low, high)).plan.numbers,
        {"low": GOAL - 9, "high": GOAL + 9},
    ),
    "control.controller.Controller.reset": (lambda x0: controlled(lambda c: c.reset(x0)), {"x0": GOAL}),
    "control.controller.Controller.retarget": (
        lambda target, goal: controlled(lambda c: c.retarget(target, goal=goal)),
        {"target": GOAL, "goal": GOAL + 1},
    ),
    "sessions.trial.Trial": (lambda x0: torchds.sessions.Trial(x0, T, DT, PLANE).reference(POLICY).x, {"x0": GOAL}),
    "preparation.Preparation.shift_to_goal": (lambda goal: list(DEMOS.shift_to_goal(goal)), {"goal": GOAL}),
    "preparation.Preparation.with_stiffness": (lambda value: list(DEMOS.with_stiffness(value)), {"value": GOAL + 9}),
}

# Not for people: what the library hands from one part to another, and what only holds it.
INSIDE = {
    "cartesian.CartesianImpedance", "cartesian.CartesianImpedance.in_plane", "sessions.trial.Trial.terms",
    "targets.Plane.state", "targets.Plane.turn",
    "exploration.base.Exploration.__call__", "exploration.base.Exploration.measure",
    "exploration.gaussian.Gaussian.__call__", "exploration.homogeneous.Homogeneous.__call__",
    "exploration.homogeneous.Homogeneous.measure", "exploration.stable.Stable.__call__", "exploration.stable.Stable.measure",
    "exploration.stable.Stable.stabilise", "exploration.trajectory.TrajectorySpace.__call__",
    "exploration.trajectory.TrajectorySpace.measure", "fits.Noise.like", "optim.functional.failures",
    "optim.functional.quantile", "optim.sharded.Sharded.together",
    "forces.ConstantForce.__call__",
    "forces.DivergentForce.__call__", "forces.SpringForce.__call__",
    "impedance.ImpedanceControlled.reset", "mending.resample", "parameters.ExpertParameters",
    "parameters.ExpertParameters.from_rows", "parameters.ExpertParameters.join", "parameters.arrange",
    "parameters.cat_broadcast", "passive.PassiveControlled.reset",
    "plants.PointMass.advance", "plants.PointMass.reset", "policy.GMRPolicy.feature_gating",
    "policy.GMRPolicy.field", "policy.GMRPolicy.outputs", "policy_file.completed", "policy_file.write",
    "preparation.gradient", "moments.Rollout", "moments.advance", "moments.begin", "moments.record",
    "starts.fit_batch", "stops.Bounds.__call__", "stops.Walls.__call__", "testing.check_plant", "testing.check_policy",
    "testing.check_stop", "visits.whole",
}  # fmt: skip
ELSEWHERE = {
    "optim.base.PolicySearch.ask",
    "visits.report",  # tests/faults/test_optimizer.py
    "control.playback.Playback.step",
    "control.playback.Recorder.add",  # of numbers as they come, tests/torchds/control
}

ANY_LENGTH = {
    ("costs.acceleration_steps", "v"), ("costs.acceleration", "v"), ("costs.path_length", "v"), ("costs.stiffness", "s"),
    ("mixture.GaussianMixture.condition", "x"), ("mixture.GaussianMixture.fit", "data"), ("mixture.joint_samples", "data"),
    ("optim.functional.cost_weights", "costs"), ("optim.functional.relative_costs", "costs"),
    ("optim.functional.informative", "costs"), ("mending.Mending.from_samples", "positions"),
    ("demonstrations.Demonstrations", "stiffness"), ("poses.quaternion", "x"), ("poses.matrix", "x"),
    ("poses.angular_velocity", "x"), ("plotting.limits", "tracks"), ("plotting.small_map", "tracks"),
    ("plotting.shown", "x"), ("plotting.trajectories", "x"),
    ("plotting.markers", "starts"), ("plotting.markers", "goal"), ("plotting.walls", "segments"),
    ("plotting.discs", "centres"),
    ("poses.angular_velocity", "v"), ("preparation.Preparation.with_stiffness", "value"),
}  # fmt: skip
OPTIONAL = {"P", "stiffness_A", "stiffness_b", "direction", "torque_limit", "gating", "free", "velocities"}
OPTIONAL_IN = {
    "goal": ("retarget", "Gaussian", "TrajectorySpace", "fit", "Preparation", "save", "from_poses"),
    "v": ("Demonstrations",),
}
OPTIONAL_IN |= {"stiffness": ("from_mixture", "from_demonstrations", "ImpedanceControlled", "Demonstrations")}


def plain(value):
    """A result as nested lists of tensors and other plain values."""
    if isinstance(value, nn.Module):
        return plain(value.state_dict())
    if isinstance(value, torch.Tensor):
        return value.detach()
    if isinstance(value, torchds.GaussianMixture):
        return [value.priors, value.means, value.covariances]
    if dataclasses.is_dataclass(value):
        return [plain(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, dict):
        return [plain(part) for part in value.values()]
    return [plain(part) for part in value] if isinstance(value, (list, tuple)) else value


def same(a, b):
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and torch.allclose(a, b, rtol=0, atol=0, equal_nan=True)
    return np.array_equal(a, b)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow
def test_arrays_and_lists_are_the_same_numbers(name):
    call, tensors = CASES[name]
    expected = plain(call(**tensors))
    for kind in (lambda x: x.numpy(), lambda x: x.tolist()):
        assert same(plain(call(**{argument: kind(value) for argument, value in tensors.items()})), expected)
        for argument in tensors:
            assert same(plain(call(**{**tensors, argument: kind(tensors[argument])})), expected), argument


class Thing:
    """No array of numbers."""


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow
def test_what_is_no_array_of_numbers_is_refused(name):
    call, tensors = CASES[name]
    for argument, value in tensors.items():
        wrong = {
            "text": "left",
            "complex": value * 1j,
            "object": Thing(),
            "ragged": [[1.0], [1.0, 2.0]],
            "dict": {"a": 1.0},
        }
        if argument not in OPTIONAL and not any(where in name for where in OPTIONAL_IN.get(argument, ())):
            wrong["none"] = None
        if (name, argument) not in ANY_LENGTH:
            wrong["longer"] = torch.cat([value, value[..., :1]], -1)
        if (name, argument) == ("exploration.gaussian.Gaussian", "std"):  # one entry for each parameter
            del wrong["ragged"]
        for kind, bad in wrong.items():
            with pytest.raises(TorchdsError) as refused:
                call(**{**tensors, argument: bad})
                pytest.fail(f"{argument} took {kind}")
            assert len(str(refused.value)) < 600, kind


def takes_tensors():
    """The public callables of the stable modules with arguments that are tensors."""
    for info in pkgutil.walk_packages(torchds.__path__, "torchds."):
        try:
            module = importlib.import_module(info.name)
        except MissingPackageError:  # compiled code, without what compiles it
            continue
        if "Stability: stable" not in (module.__doc__ or ""):
            continue
        for name, value in vars(module).items():
            if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
                continue
            members = {name: value} if inspect.isfunction(value) else {}
            if inspect.isclass(value) and not issubclass(value, tuple) and not getattr(value, "_is_protocol", False):
                own = {key: getattr(member, "__func__", member) for key, member in vars(value).items()}
                members = {
                    name if key == "__init__" else f"{name}.{key}": member
                    for key, member in own.items()
                    if inspect.isfunction(member) and (key in ("__init__", "__call__") or not key.startswith("_"))
                }
            for key, member in members.items():
                kinds = [str(parameter.annotation) for parameter in inspect.signature(member).parameters.values()]
                if any(re.search("Tensor|Array", kind) and "Callable" not in kind for kind in kinds):
                    yield f"{module.__name__.removeprefix('torchds.')}.{key}"


def test_every_public_callable_that_takes_tensors_is_among_the_cases():
    known = set(CASES) | INSIDE | ELSEWHERE
    found = set(takes_tensors())
    assert sorted(found - known) == [], "give it a case here"
    assert known - found <= {"plants.PointMass", "exploration.trajectory.Coordinates.theta"}, (
        "there is none of this name any more"
    )
