"""`python -m train view lwr_digging --policy DIR`: a learned digging motion in MuJoCo's viewer."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from torchds import Rollout
from torchds.errors import InvalidArgumentError, TorchdsError
from train.folder import OPTIONS, POLICY, RunFolder
from train.learning.learner import Learner
from train.options import RunOptions

if TYPE_CHECKING:
    from tasks.digging.gravel import Gravel

PER_SECOND = 30  # frames


class NoDisplayError(TorchdsError, RuntimeError):
    """There is no screen to open a window on."""


@dataclass
class View:
    """Show a trial of a learned policy in MuJoCo's viewer, again and again until its window is closed."""

    task: Annotated[Literal["lwr_digging"], tyro.conf.Positional]
    """The task; only this one has a scene to look at."""
    policy: Path
    """Folder of the run that learned the policy."""
    run: int = 0
    """Which of the run's policies."""

    def main(self) -> None:
        """Make one trial and show it.

        Raises:
            NoDisplayError: there is no screen.
            InvalidArgumentError: the folder holds no policy of this task.
        """
        options = self.options()
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise NoDisplayError(
                "no window can be opened: neither DISPLAY nor WAYLAND_DISPLAY is set. Run this on a machine with a screen, or "
                f"look at {self.policy / 'film.gif'}, which the run left"
            )
        learner = Learner(options)
        policy = RunFolder(self.policy).policy()
        print("one trial, then the window opens ...")
        task: Any = learner.task
        show(task.gravel, learner.task.rollout(policy[self.run]))

    def options(self) -> RunOptions:
        """Those of the run in the folder.

        Raises:
            InvalidArgumentError: see `main`.
        """
        folder = RunFolder(self.policy, "--policy")
        folder.require(OPTIONS, POLICY)
        options = folder.options()
        if options.task != self.task or not 0 <= self.run < options.runs:
            raise InvalidArgumentError(
                f"--policy {self.policy}: a run of {options.task!r} with {options.runs} policies; needed is one of "
                f"{self.task!r} that has policy {self.run}"
            )
        return options


def show(gravel: Gravel, path: Rollout) -> None:
    """Play the snapshots of a trial at their pace until the window is closed."""
    import mujoco
    import mujoco.viewer

    from tasks.digging.rendering import picture_model
    from tasks.digging.simulation import SNAPSHOT

    model = picture_model(gravel)
    data = mujoco.MjData(model)
    between = round(PER_SECOND * SNAPSHOT)
    with mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False) as window:
        while window.is_running():
            for before, after in zip(path.plant.snapshots[:-1], path.plant.snapshots[1:], strict=True):
                for i in range(between):
                    if not window.is_running():
                        return
                    data.qpos[:] = before.lerp(after, i / between).numpy()
                    mujoco.mj_kinematics(model, data)
                    window.sync()
                    time.sleep(1 / PER_SECOND)
