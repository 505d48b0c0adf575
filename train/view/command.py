"""`python -m train view TASK --policy DIR`: a learned digging motion in MuJoCo's viewer, or any motion in a web page."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from tasks.loading import absolute
from torchds import Rollout
from torchds.errors import InvalidArgumentError, TorchdsError
from train.folder import OPTIONS, POLICY, RunFolder
from train.learning.learner import Learner
from train.options import RunOptions, options_for
from train.view.page import Page
from train.view.page import show as show_page
from train.view.takes import of_digging, of_motion

if TYPE_CHECKING:
    from tasks.digging.gravel import Gravel

PER_SECOND = 30  # frames
SHOVEL = ((0.60, -1.15, 0.70), (0.47, 0.0, 0.27))  # m, where the camera stands, and what it looks at


class NoDisplayError(TorchdsError, RuntimeError):
    """There is no screen to open a window on."""


@dataclass
class View:
    """Look at a learned policy: digging in MuJoCo's viewer, or any task's motion in a web page."""

    task: tyro.conf.Positional[str]
    """The task."""
    policy: Path | None = None
    """Folder of the run that learned the policy; without one, the page shows the demonstrated policy alone."""
    run: int = 0
    """Which of the run's policies."""
    browser: tyro.conf.UseCounterAction[int] = 0
    """Show it in a web page (extra "view"), before and after learning; needs no screen on this machine."""
    trials: int = 2
    """Trials of digging to choose from on the page."""
    grains: Literal["fine", "coarse"] = "fine"
    """The bed of digging, where there is no run that says it."""
    port: int = 8080
    """Of the page."""

    def main(self) -> None:
        """Make trials and show them.

        Raises:
            NoDisplayError: there is no screen for a window.
            InvalidArgumentError: the folder holds no policy of this task, or there is nothing to show.
        """
        if self.trials < 1:
            raise InvalidArgumentError(f"--trials has to be at least 1, got {self.trials}")
        if self.browser:
            return show_page(self.page())
        if self.task != "lwr_digging" or self.policy is None:
            raise InvalidArgumentError(
                "a window needs the task lwr_digging and --policy; with --browser a page shows any task"
            )
        options = self.options(self.policy)
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise NoDisplayError(
                "no window can be opened: neither DISPLAY nor WAYLAND_DISPLAY is set. Add --browser, run this on a machine "
                f"with a screen, or look at {self.policy / 'film.gif'}, which the run left"
            )
        learner = Learner(options)
        policy = RunFolder(self.policy).policy()
        print("one trial, then the window opens ...")
        task: Any = learner.task
        show(task.gravel, learner.task.rollout(policy[self.run]))

    def page(self) -> Page:
        """The page, which is served from here on."""
        digging = {"grains": self.grains} if self.task == "lwr_digging" else {}
        options = options_for(self.task, **digging) if self.policy is None else self.options(self.policy)
        task: Any = replace(options, device="cpu").make_task()  # wherever it was learned
        policies = {"before learning": task.policy()}
        if self.policy is not None:
            policies["after learning"] = RunFolder(self.policy).policy()[self.run]
        if self.task != "lwr_digging":
            return Page(self.task, of_motion(task, policies), port=self.port)
        from tasks.digging.rendering import picture_model
        from train.view.shapes import Shapes

        print(f"{self.trials * len(policies)} trials, then the page opens ...")
        takes = of_digging(task, policies, self.trials)
        return Page("digging", takes, Shapes(picture_model(task.gravel)), port=self.port, look=SHOVEL)

    def options(self, path: Path) -> RunOptions:
        """Those of the run in the folder.

        Raises:
            InvalidArgumentError: see `main`.
        """
        folder = RunFolder(path, "--policy")
        folder.require(OPTIONS, POLICY)
        options = folder.options()
        if options.task != absolute(self.task) or not 0 <= self.run < options.runs:
            raise InvalidArgumentError(
                f"--policy {path}: a run of {options.task!r} with {options.runs} policies; needed is one of "
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
