"""The Python script that learns a problem file, with a comment for each step."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tasks.loading import absolute, short
from tasks.sketch.problem import Problem
from torchds.errors import InvalidArgumentError

CHECKOUT = Path(__file__).parents[2]

BEGIN = """\
# {name}: a drawn motion becomes a dynamical system, and learns by trial.
# Run it with the Python that has torchds: python this_file.py

import sys

import torch

sys.path.insert(0, {checkout!r})  # the checkout of torchds, for the packages tasks and train

from train.learning.learner import Learner
from train.learning.run import distinct
from train.options import options_for
from train.statistics import of_costs

torch.set_num_threads(1)  # tensors are small: a second thread costs more than it gives

# 1. The problem: what was drawn, what is asked of the motion, and how it is learned. Options that are not given here are
#    those of the first learner in the file.
options = options_for({given})
task = options.make_task()

# 2. The demonstrations: the strokes, at equal time steps, with velocities.
demonstrations = task.demonstrations
print(demonstrations)
for finding in demonstrations.check():  # what is suspicious about them
    print(finding)
"""

FREE = """
# 3. The mixture: Gaussians over position and velocity together, found by expectation maximisation.
mixture = task.mixture
print(mixture)

# 4. The policy: at each position, the velocity that the mixture expects there, a dynamical system that can begin anywhere.
policy = task.policy()
"""

STABLE = """
# 3. The mixture: Gaussians over position and velocity, learned so that each of them leads to the goal.
fit = task.stable_fit

# 4. The policy: at each position the velocity that the mixture expects there. From wherever it begins, it ends at the goal; the
#    certificate says how quickly it is sure to come closer.
policy = task.policy()
print(policy.certificate(task.goal, task.P))
"""

BODY = """\
# It says how stiff the body is held, too: a point mass follows the motion, pulled by a spring and a damper.
print(policy.stiffness(task.motion().x0))  # at the start, of each axis
"""

END = """
# 5. A trial: where the motion goes, and what that costs.
with torch.no_grad():
    path = task.rollout(policy)
    for name, cost in task.cost_terms(path).items():
        print(f"{{name}} {{float(cost):.6g}}")

# 6. The learner: each update tries some policies beside the present one, and moves it towards those that cost little. All
#    runs learn at once, each with noise of its own; where nothing is random, one run stands for all. The cost below is that of
#    a trial without noise.
learner = Learner(distinct(options, task), task)
learner.start()
while learner.done < learner.n_updates:
    learner.update()
    _, median, _ = of_costs(learner.history.cost[-1])
    print(f"update {{learner.done}} of {{learner.n_updates}}: median cost {{median:.6g}}")

# 7. One file for the policies of all runs, and what belongs to them; torchds.load_policy({saved!r}) reads it.
learner.policy.save({saved!r}, **task.about(learner.policy))
"""


def script(problem_file: str | Path, options: Mapping[str, Any] | None = None) -> str:
    """A script that does what the training command does with a problem file, and saves the policies where it is run.

    Args:
        problem_file: that it learns; its whole path stands in the script.
        options: of the training command by name, beside those of the file's first learner; plain values.

    Raises:
        FileError: there is no such file.
        InvalidArgumentError: it holds no problem, or an option is none that can be written down.
    """
    spec = absolute(str(problem_file))
    problem, options = Problem.read(spec), options or {}
    for name, value in options.items():
        if not name.isidentifier() or not isinstance(value, (bool, int, float, str, type(None))):
            raise InvalidArgumentError(f"options have to be plain values by name, got {name}={value!r}")
    given = ", ".join([repr(spec), *(f"{name}={value!r}" for name, value in options.items())])
    fitted = FREE if problem.condition == "none" else STABLE
    text = BEGIN + fitted + (BODY if problem.body is not None else "") + END
    name = problem.name or short(spec)
    return text.format(name=name, checkout=str(CHECKOUT), given=given, saved=f"{short(spec)}.pt")
