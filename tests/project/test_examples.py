"""The examples of the pages run as they stand there: in an empty folder, with the files and names that a page speaks of."""

import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

import torchds
from tests.motions import Short
from torchds.errors import DemonstrationWarning

DOCS = Path(__file__).parents[2] / "docs"
FOREVER = "while True:"
T = np.linspace(0, 1, 61)
REST = ((1 - T) ** 2 * (1 + 2 * T))[:, None]  # what is left of a motion from rest to rest


def blocks(page):
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


def shown(code):
    """A loop that has no end, cut after five rounds."""
    assert code.count(FOREVER) == 1
    return code.replace(FOREVER, "for _ in range(5):")


def write(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=header, comments="")


def poses(path, header, seconds, start, end, turn):
    """Write a motion of poses, `turn` the rotation vector of its start from the goal."""
    angle = np.linalg.norm(turn)
    quaternion = np.hstack([np.sin(REST * angle / 2) * turn / angle, np.cos(REST * angle / 2)])
    write(path, header, seconds * T, end + REST * (np.array(start) - end), quaternion)


def compiled():
    """The scalar step does the same as the call on tensors, and numba compiles it; the roll-out is eager here, to be quick."""
    (code,) = blocks("compiled.md")
    exec(code, space := {})
    circle, x = space["Circle"](2.0), 1.5 * torch.randn(50, 2, generator=torch.Generator().manual_seed(0))
    x[0, 0] = torch.nan
    step, expected = circle.scalar_step(2, 0), circle(x, x).tolist()
    assert [step.function(step.parameters.numpy(), each, each) for each in x.numpy()] == expected
    outside = pytest.importorskip("numba").njit(step.function)
    assert [outside(step.parameters.numpy(), each, each) for each in x.numpy()] == expected and not all(expected)


def problem_files():
    """A problem in memory is the task of its file."""
    (code,) = blocks("problem_files.md")
    exec(code, space := {})
    file = space["tasks"].make(str(space["examples"]()["an_s"]))
    assert torch.equal(space["task"].demonstrations[0].x, file.demonstrations[0].x)


def deploy():
    """The file is a policy with all that was said about it, and the loop runs it within its bounds."""
    file, loop, _ = blocks("deploy.md")  # the programs of the third are made in tests/torchds/test_exporting.py
    exec(file, space := {})
    info = space["policy"].info
    assert (info.names, info.units, info.dt) == (space["demos"].names, "mm", 0.001)
    space["x0"] = space["demos"][0].x[0].numpy()
    exec(shown(loop), space)
    assert space["controller"].dt == 0.001
    assert 0 < np.linalg.norm(space["tick"].x - space["x0"]) < 200.0 * 5 * 0.001


def data():
    """Two tables become what the page says."""
    tables, pose_files = blocks("data.md")
    Path("runs").mkdir()
    for k in range(3):
        write(f"runs/{k}.csv", "time,x,y", T, REST * (1, -0.5 - 0.1 * k))
    exec(tables, space := {})
    assert len(space["demos"]) == 3 and space["policy"].input_dim == 2
    poses("poses.csv", "time,x,y,z,qx,qy,qz,qw", 1.0, (1, 1, 0), (0, 0, 0.5), (0.4, 0, 0.6))
    with pytest.warns(DemonstrationWarning, match="unit quaternion"):
        exec(pose_files, space)
    first = torch.from_numpy(np.loadtxt("poses.csv", delimiter=",", skiprows=1)[0, 4:])
    torch.testing.assert_close(space["q"][0], first, rtol=0, atol=1e-3)
    assert space["omega"].shape == (500, 3)


def hardware():
    """From demonstrations to the best policy, with a robot that does what it is asked and presses a little harder each time."""
    learn, loop, script, play = blocks("hardware.md")
    for k in (1, 2, 3):
        header = "time [s],x [m],y [m],z [m],qx,qy,qz,qw"
        poses(f"{k}.csv", header, 3.0, (0.43 + 0.01 * k, -0.2, 0.5), (0.6, 0, 0.3), (0.4, 0, 0.6))
    exec(learn, space := {})
    measured = space["demos"][1].x[0].numpy()
    sys.argv[1:] = ["ask"]
    exec(script, {})
    for k in range(1, 9):
        robot = Robot(4.0 + 0.1 * k)
        names = {name: getattr(robot, name) for name in ("go_to", "command", "measured_state", "measured_force")}
        exec(play.replace("rollout-3", f"rollout-{k}"), names)
    sys.argv[1:] = ["tell"]
    exec(script, script_space := {})
    session = script_space["session"]
    assert session.done == 1 and session.history.terms["force"] == [[pytest.approx(0.9**2)]]
    exec(re.search(r"`(session\.export\(.*?\))`", (DOCS / "hardware.md").read_text())[1], script_space)
    exec(shown(loop.replace("policy.pt", "best.pt")), space := space | {"measured": measured})
    assert space["controller"].dt == 0.001


class Robot:
    """Is at once where it is asked to be, and presses with one force."""

    def __init__(self, force):
        self.force = force

    def go_to(self, x):
        self.x = np.array(x)

    def command(self, x, v, stiffness):
        self.go_to(x)

    def measured_state(self):
        return self.x

    def measured_force(self):
        return [self.force]


def learned():
    """What recommended.md and exploration.md speak of."""
    task = Short()
    x0, n_steps, dt = task.motion()
    return task, {"torch": torch, "torchds": torchds, "policy": task.policy(), "x0": x0, "n_steps": n_steps, "dt": dt}


def recommended():
    """An update with these settings, and its decay."""
    (code,) = blocks("recommended.md")
    task, space = learned()
    exec(code, space)
    space["optim"].step(lambda: task.cost(task.rollout(space["policy"])))
    space["decay"].step()
    assert 0.9 < space["optim"].param_groups[0]["lr"] < 1
    assert not torch.equal(space["policy"].pack(), task.policy().pack())


def exploration():
    """The policy is at the coordinates of the page, as its comment makes them too."""
    (code,) = blocks("exploration.md")
    _, space = learned()
    policy = space["policy"]
    along = torchds.exploration.TrajectorySpace.relative(policy, space["x0"], space["n_steps"], space["dt"])
    coordinates = along.coordinates()
    z = torch.linspace(-1, 1, coordinates[1].shape[-1], dtype=torch.float64)
    exec(code, space | {"along": along, "z": z})
    torch.testing.assert_close(policy.pack(), coordinates.theta(z))


PAGES = {each.__name__: each for each in (compiled, problem_files, deploy, data, hardware, recommended, exploration)}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_examples_of_a_page_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TORCHDS_BACKEND", "eager")
    monkeypatch.setattr(sys, "argv", ["script.py"])
    monkeypatch.setattr(torchds, "fit_stable", partial(torchds.fit_stable, n_steps=40))  # of 600, to be quick
    PAGES[page]()
