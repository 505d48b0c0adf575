import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import tasks
from tasks.sketch import Problem, Sketch
from tasks.sketch.task import of_file
from tests.tasks.sketch.drawn import FULL, strokes
from torchds import costs, stability
from torchds.errors import FileError, InvalidArgumentError
from torchds.impedance import ImpedanceControlled
from torchds.passive import PassiveControlled

SMALL = Problem(strokes=strokes(2), samples=40, components=2)


def test_a_drawing_is_a_task_that_imitates_it():
    task = Sketch.of(replace(SMALL, components=4))()
    path = task.rollout(task.policy())
    mean = torch.stack([d.x for d in task.demonstrations]).mean(0)
    assert torch.equal(path.x[0], mean[0]) and torch.allclose(task.scene().goal, mean[-1])
    assert (path.x.detach() - mean).norm(dim=-1).max() < 0.3
    assert list(task.cost_terms(path)) == ["goal", "acceleration"]
    assert task.plant is task.stop is task.P is None and task.differentiable


def test_start_and_goal_are_where_they_are_put():
    task = Sketch.of(replace(SMALL, start=(1.0, 0.5), goal=(-2.0, 0.0)))()
    assert task.motion().x0.tolist() == [1.0, 0.5] and task.scene().goal.tolist() == [-2.0, 0.0]
    assert all(torch.allclose(d.x[-1], torch.tensor([-2.0, 0.0]).double()) for d in task.demonstrations)


def test_the_cost_is_the_sum_of_what_there_is_times_its_weight():
    weights = {
        "via_points": 2.0,
        "goal": 3.0,
        "acceleration": 0.5,
        "path_length": 0.25,
        "regions": 4.0,
        "stiffness": 0.1,
    }
    body = {"stiffness": 50.0}
    task = Sketch.of(replace(FULL, weights=weights, body=body, regions=[{"center": (0, 0), "radius": 2.0}]))()
    with torch.no_grad():
        path = task.rollout(task.policy())
    x, v = path.x.numpy(), path.v.numpy()
    expected = {
        "goal": 3.0 * ((x[-1] - [-0.9, 0.05]) ** 2).sum(),
        "via_points": 2.0 * min(((x_j - [0.4, 0.5]) ** 2).sum() for x_j in x[1:]),
        "regions": 4.0 * max(2.0 - np.linalg.norm(x_j) for x_j in x[1:]) ** 2,
        "acceleration": 0.5 * sum(np.linalg.norm(v[j] - v[j - 1]) for j in range(1, len(v))),
        "path_length": 0.25 * sum(np.linalg.norm(v_j) for v_j in v) * path.dt,
        "stiffness": 0.1 * sum(np.linalg.norm(s) for s in path.plant.stiffness[1:].numpy()),
    }
    terms = {name: float(term) for name, term in task.cost_terms(path).items()}
    assert terms == pytest.approx(expected, rel=1e-12)
    assert float(task.step_costs(path).sum()) == pytest.approx(sum(expected.values()), rel=1e-12)


def test_terms_without_a_weight_are_left_out_but_for_the_goal():
    none = dict.fromkeys(SMALL.weights, 0.0)
    task = Sketch.of(replace(SMALL, via_points=[(0, 0)], weights=none))()
    assert list(task.cost_terms(task.rollout(task.policy()))) == ["goal"]


@pytest.mark.slow
@pytest.mark.parametrize(("condition", "body"), [("seds", None), ("p-qlf", {"stiffness": 30.0})])
def test_under_a_condition_the_policy_is_stable_at_the_goal(condition, body):
    task = Sketch.of(replace(SMALL, condition=condition, body=body, goal=(-1.0, 0.5)))()
    policy = task.policy()
    assert bool(stability.certificate(policy, task.goal, task.P).stable)
    assert (task.P is None) == (condition == "seds") and task.defaults["exploration"] == "stable"
    assert policy.stiffness_b is None if body is None else policy.stiffness_b.tolist() == [[30.0, 30.0]] * 2
    policy.A.data.zero_()
    assert task.policy().A.abs().max() > 0  # each policy is a new one


@pytest.mark.parametrize(
    ("execution", "plant", "feedback"),
    [("open", ImpedanceControlled, False), ("closed", ImpedanceControlled, True), ("passive", PassiveControlled, True)],
)
def test_a_body_follows_the_motion(execution, plant, feedback):
    task = Sketch.of(replace(SMALL, body={"execution": execution, "mass": 2.0, "damping": 0.5, "stiffness": 80.0}))()
    assert type(task.plant) is plant and task.feedback is feedback and task.plant.plant.mass == 2.0
    path = task.rollout(task.policy())
    assert path.plant.stiffness[-1].tolist() == [80.0, 80.0] and path.x.isfinite().all()


def test_fields_of_force_push_the_body():
    constant = Sketch.of(replace(SMALL, body={"field": "constant", "force": (1.0, -2.0)}))()
    path = constant.rollout(constant.policy())
    assert (path.plant.force[1:] == torch.tensor([1.0, -2.0])).all()
    divergent = Sketch.of(replace(SMALL, body={"field": "divergent", "gain": 3.0}))()
    mean = torch.stack([d.x for d in divergent.demonstrations]).mean(0)
    x = mean[20] + torch.tensor([0.0, 1e-3])
    nearest = mean[(mean - x).norm(dim=-1).argmin()]
    force = divergent.plant.plant.force(0.0, x, x)
    assert torch.allclose(force, 3.0 * (x - nearest), rtol=0, atol=1e-12)


def test_a_motion_that_meets_a_wall_stays_there():
    wall = ((0.0, -1.0), (0.0, 1.0))
    task = Sketch.of(replace(SMALL, walls=[wall]))()
    x = task.rollout(task.policy()).x
    assert (x[:, 0] > 0).all() and torch.equal(x[-1], x[-2]) and not task.differentiable
    assert task.scene().walls.tolist() == [[[0, -1], [0, 1]]]


def test_a_region_is_in_the_scene_and_costs():
    task = Sketch.of(replace(SMALL, regions=[{"center": (0.0, 0.0), "radius": 0.3}]))()
    path = task.rollout(task.policy())
    assert torch.equal(task.cost_terms(path)["regions"], costs.intrusion(path.x, [[0.0, 0.0]], [0.3]))
    assert task.scene().regions.radii.tolist() == [0.3]


def test_an_empty_drawing_says_so():
    with pytest.raises(InvalidArgumentError, match="nothing is drawn"):
        Sketch.of(Problem())().policy()


def test_a_file_is_a_task_by_its_path(tmp_path, monkeypatch):
    file = tmp_path / "My letter-S.json"
    SMALL.write(file)
    task = tasks.make(str(file))
    assert task.name == "my_letter_s" and task.problem == SMALL
    made = of_file(file)
    monkeypatch.chdir(tmp_path)
    assert of_file("My letter-S.json") is made is type(task) is tasks.task_class(str(file))
    replace(SMALL, components=3).write(file)
    assert of_file(file) is not made and tasks.make(str(file)).n_components == 3


def test_a_file_that_is_no_problem_is_explained(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        tasks.make(str(tmp_path / "a.json"))
    (tmp_path / "a.json").write_text(json.dumps({"torchds": "problem", "samples": 1}))
    with pytest.raises(InvalidArgumentError, match=r"a.json: samples has to be"):
        tasks.make(str(tmp_path / "a.json"))
    SMALL.write(tmp_path / "via_point.json")
    with pytest.raises(InvalidArgumentError, match=r"'via_point' of Sketch belongs to .*; give the file .* another"):
        tasks.make(str(tmp_path / "via_point.json"))
