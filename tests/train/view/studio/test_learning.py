"""A learning run that can be watched."""

import pytest
import torch

from tasks.sketch import Sketch
from tests import drawn
from train.folder import RunFolder
from train.learning.learner import Learner
from train.options import options_class
from train.view.studio.learning import POINTS, Apprentice, best, learn, thinned, watched
from train.view.studio.worker import Failed


class Told:
    """A pipe with these messages in it; between "go" and what follows, so many looks find nothing."""

    def __init__(self, *messages):
        self.messages, self.answers, self.quiet = list(messages), [], 0

    def next(self):
        if not self.messages:
            raise EOFError
        message = self.messages.pop(0)
        self.quiet = message[2] if len(message) > 2 else 0
        return message[:2]

    def waits(self, seconds=0.0):
        self.quiet -= 1
        return self.quiet < 0

    def send(self, message):
        self.answers.append(message)


def begun(folder, **fields):
    drawn.problem(**fields).write(folder / "problem.json")
    options = options_class(str(folder / "problem.json"))()
    RunFolder(folder).begin(options.task, options.to_json())
    return options


def served(folder, *messages):
    pipe = Told(*messages)
    with pytest.raises(EOFError):
        learn(pipe, folder)
    return pipe.answers


def test_it_learns_what_the_learner_learns_step_by_step_and_with_interruptions(tmp_path):
    options = begun(tmp_path)
    direct = Learner(options).learn()
    pictures = served(tmp_path, ("step", None), ("step", None))
    assert [picture.done for picture in pictures] == [0, 1, 2]
    more = served(tmp_path, ("go", 1e9, 10), ("pause", None))  # another process goes on
    assert more[0].done == 2 and more[-1].done == 4 == more[-1].of
    torch.testing.assert_close(more[-1].policies.pack(), direct.policy.pack(), rtol=0, atol=0)
    assert more[-1].rollouts == [0, 6, 12, 18, 24]
    medians = torch.tensor(direct.history.cost).quantile(0.5, dim=1)
    torch.testing.assert_close(torch.tensor(more[-1].curves["total"]), medians)
    assert set(more[-1].curves) == {"total", *direct.history.terms}


@pytest.mark.parametrize("cost_noise, runs", [(0.0, 1), (0.1, 3)])
def test_where_nothing_is_random_one_run_stands_for_all(tmp_path, cost_noise, runs):
    begun(tmp_path, learners=[{"optimizer": "finite_differences", "runs": 3, "updates": 60, "cost_noise": cost_noise}])
    (first,) = served(tmp_path)
    assert first.policies.batch_shape == (runs,) and RunFolder(tmp_path).options().runs == runs
    (again,) = served(tmp_path)  # from its checkpoint
    assert again.policies.pack().equal(first.policies.pack())


def test_a_run_of_copies_goes_on_as_it_was_begun(tmp_path):
    options = begun(tmp_path, learners=[{"optimizer": "finite_differences", "runs": 3, "updates": 60}])
    learner = Learner(options)
    learner.start()
    RunFolder(tmp_path).save_checkpoint(learner)
    (picture,) = served(tmp_path)
    assert picture.policies.batch_shape == (3,) and RunFolder(tmp_path).options().runs == 3


def test_a_picture_holds_the_trials_and_the_motions(tmp_path):
    begun(tmp_path)
    first, second = served(tmp_path, ("step", None))
    assert first.trials == [] and [x.shape for x in second.trials] == [(12, 41, 2)]
    assert second.motion.shape == (2, 41, 2)
    assert second.policy.pack().equal(second.policies[second.best].pack())


def test_what_stops_is_kept_even_if_nobody_hears_it(tmp_path):
    begun(tmp_path)
    served(tmp_path, ("go", 1e9, 2))
    assert served(tmp_path)[0].done >= 1


@pytest.mark.parametrize(
    "learner, words",
    [({"optimizer": "newton"}, "newton"), ({"updates": 3, "rollouts": 0}, "at least 1"), ({"noise": -1.0}, "got -1.0")],
)
def test_options_that_do_not_fit_are_a_sentence(tmp_path, learner, words):
    drawn.problem(learners=[{}]).write(tmp_path / "problem.json")
    options = options_class(str(tmp_path / "problem.json"))()
    RunFolder(tmp_path).begin(options.task, {**options.to_json(), **learner})
    pipe = Told()
    learn(pipe, tmp_path)
    (answer,) = pipe.answers
    assert isinstance(answer, Failed) and words in answer.message and "\n" not in answer.message


def test_roll_outs_are_watched_as_they_are_made():
    task = Sketch.of(drawn.problem())()
    paths = watched(task)
    policy = task.policy()
    first, second = task.rollout(policy), task.rollout(policy)
    assert paths[0] is first and paths[1] is second


def test_long_motions_are_thinned_to_their_last_point():
    x = torch.arange(2 * 3 * 501 * 2, dtype=torch.float64).reshape(2, 3, 501, 2)
    thin = thinned(x)
    assert thin.shape == (6, POINTS, 2) and thin[:, -1].tolist() == x[..., -1, :].reshape(6, 2).tolist()
    assert thinned(x[..., :20, :]).shape == (6, 20, 2)


def test_the_best_run_has_the_lowest_cost_that_is_a_number():
    nan = float("nan")
    assert best([3.0, nan, 1.0]) == 2 and best([nan, nan]) == 0


def test_it_is_paused_to_begin_with_and_when_all_is_made(tmp_path):
    begun(tmp_path)
    pipe = Told(("step", None))
    apprentice = Apprentice(pipe, RunFolder(tmp_path))
    assert not apprentice.finished and apprentice.pace == 0
    while not apprentice.finished:
        apprentice.pace = 5.0
        apprentice.update()
    assert apprentice.pace == 0
