"""A drawing becomes a system."""

import time

import pytest
import torch

from tasks.sketch import Problem, Sketch
from tests import drawn
from torchds.errors import InvalidArgumentError
from train.view.studio.imitating import imitate, imitated
from train.view.studio.worker import Failed


class Told:
    """A pipe with these messages in it, that then ends."""

    def __init__(self, *messages):
        self.messages, self.answers = list(messages), []

    def next(self):
        if not self.messages:
            raise EOFError
        return self.messages.pop(0)

    def send(self, message):
        self.answers.append(message)


@pytest.mark.parametrize("condition", ["none", pytest.param("seds", marks=pytest.mark.slow)])
def test_it_is_the_policy_and_the_motion_of_the_task(condition):
    problem = drawn.problem(condition=condition, samples=31)
    made, task = imitated(problem), Sketch.of(problem)()
    torch.testing.assert_close(made.policy.pack(), task.policy().pack(), rtol=0, atol=0)
    torch.testing.assert_close(made.motion, task.rollout(task.policy()).x.detach(), rtol=0, atol=0)
    assert made.findings == ()
    if condition == "seds":
        assert made.verdict == "proven" and made.margin > 0


def test_what_is_suspicious_is_said():
    rests = [*drawn.stroke(), *([2.0 + 0.05 * i, 0.8, 0.0] for i in range(1, 60))]
    assert any("stays in place" in sentence for sentence in imitated(drawn.problem(strokes=[rests, rests])).findings)


def test_each_drawing_is_answered_with_its_number():
    pipe = Told((1, Problem()), (3, drawn.problem(components=2)))
    with pytest.raises(EOFError):
        imitate(pipe)
    (first, _), (second, made) = pipe.answers
    assert (first, second) == (1, 3) and made.policy.n_components == 2


def test_an_empty_drawing_is_a_sentence():
    with pytest.raises(InvalidArgumentError, match="nothing is drawn"):
        imitated(Problem())
    pipe = Told((1, Problem()))
    with pytest.raises(EOFError):
        imitate(pipe)
    assert isinstance(pipe.answers[0][1], Failed) and "nothing is drawn" in pipe.answers[0][1].message


def test_three_demonstrations_of_200_samples_take_less_than_a_third_of_a_second():
    problem = drawn.problem(strokes=[drawn.stroke(s, 200) for s in (0.0, 0.03, 0.06)], samples=200)
    imitated(problem)
    seconds = []
    for _ in range(5):
        began = time.thread_time()  # of this thread: the machine may have other things to do
        imitated(problem)
        seconds.append(time.thread_time() - began)
    assert min(seconds) < 0.3
