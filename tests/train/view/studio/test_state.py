"""The state of the page: changes, undo, what is kept, and what the pointer and time do; workers that answer at once."""

import shutil
from dataclasses import replace
from typing import ClassVar

import pytest
import torch

from tasks.sketch import Problem, Sketch, examples
from tests import drawn
from torchds.errors import InvalidArgumentError, UnknownNameError
from train.view.studio import imitator, side
from train.view.studio.imitating import imitated
from train.view.studio.learning import Picture
from train.view.studio.state import Studio
from train.view.studio.worker import Failed, said


class Instant:
    """A worker that answers when it is asked; those of learners only write down what they are told."""

    made: ClassVar = []

    def __init__(self, work, *arguments):
        self.work, self.arguments, self.told, self.out, self.dead = work, arguments, [], [], False
        Instant.made.append(self)

    def tell(self, message):
        self.told.append(message)
        if not self.arguments:
            number, problem = message
            self.out.append((number, said(lambda: imitated(problem))))

    def answers(self):
        out, self.out = self.out, []
        return None if self.dead and not out else out

    def end(self):
        self.dead = True

    leave = end


class Looking:
    def __init__(self):
        self.seen = []

    def news(self, what):
        self.seen.append(what)


@pytest.fixture
def studio(tmp_path, monkeypatch):
    Instant.made.clear()
    monkeypatch.setattr(imitator, "Worker", Instant)
    monkeypatch.setattr(side, "Worker", Instant)
    studio = Studio(tmp_path / "studio")
    studio.put(drawn.problem())
    studio.tick(0.02)
    return studio


def words(studio):
    """What stands below the table."""
    pytest.importorskip("nicegui")
    from train.view.studio.panels import said as line

    return line(studio)


def picture(studio):
    policy = studio.imitation.policy.expand(2)
    x = studio.imitation.motion.float().expand(2, -1, -1)
    return Picture(3, 4, [0, 6, 12, 18], {"total": [4.0, 3.0, 2.0, 1.0]}, [x], x, policy, 1)


def test_it_begins_with_an_example_and_imitates_what_is_drawn(tmp_path, studio):
    assert Instant.made[0].told[0][1] == Problem.read(examples()["an_s"])
    task = Sketch.of(drawn.problem())()
    torch.testing.assert_close(studio.imitation.policy.pack(), task.policy().pack(), rtol=0, atol=0)
    assert studio.complaint == ""


def test_changes_are_undone_redone_and_found_again(tmp_path, studio):
    studio.change(components=3)
    studio.change(via_points=[[0.1, 0.1]])
    studio.undo()
    assert studio.problem == drawn.problem(components=3)
    studio.undo()
    assert studio.problem == drawn.problem()
    studio.redo()
    studio.redo()
    assert studio.problem == drawn.problem(components=3, via_points=[[0.1, 0.1]])
    studio.redo()
    again = Studio(tmp_path / "studio")
    assert again.problem == studio.problem
    studio.undo()
    studio.change(components=5)
    studio.redo()  # what was undone before another change is gone
    assert studio.problem.components == 5


def test_a_slider_that_is_dragged_is_undone_at_once(studio):
    for k in (5, 6, 7):
        studio.adjust(components=k)
    studio.undo()
    assert studio.problem == drawn.problem()


@pytest.mark.parametrize(
    "fields, error",
    [
        ({"components": 0}, InvalidArgumentError),
        ({"components": 10**9}, InvalidArgumentError),
        ({"samples": float("nan")}, InvalidArgumentError),
        ({"via_points": [[float("nan"), 0.0]]}, InvalidArgumentError),
        ({"strokes": [[[0.01 * i, 0.1 * i, 0.0] for i in range(10_000)]]}, InvalidArgumentError),
        ({"strokes": [[[0.0, 0.0, 0.0]]]}, InvalidArgumentError),
        ({"weights": {"goal": -1.0}}, InvalidArgumentError),
        ({"condition": "sure"}, UnknownNameError),
    ],
)
def test_values_out_of_range_are_a_sentence_and_change_nothing(tmp_path, studio, fields, error):
    with pytest.raises((InvalidArgumentError, error)) as refused:
        studio.change(**fields)
    assert "got" in str(refused.value) or "unknown" in str(refused.value).lower()
    assert studio.problem == drawn.problem() and Studio(tmp_path / "studio").problem == drawn.problem()


def test_while_one_draws_the_system_follows_and_a_dot_is_refused(studio):
    studio.change(strokes=[])
    assert studio.imitation is None and studio.task is None
    studio.draw([(5.0 + t, x1, x2) for t, x1, x2 in drawn.stroke()[:30]], False)
    studio.tick(0.02)
    assert studio.imitation is not None and studio.problem.strokes == ()
    with pytest.raises(InvalidArgumentError, match="too short"):
        studio.draw([(5.0, 0.1, 0.1)], True)
    studio.draw([(5.0, 0.1, 0.1)], False)  # it has just begun: nothing is said yet
    studio.draw([(5.0 + t, x1, x2) for t, x1, x2 in drawn.stroke()], True)
    assert len(studio.problem.strokes) == 1


def test_what_cannot_be_fitted_is_said_and_an_answer_of_yesterday_is_not_taken(studio):
    line = [[0.1 * i, 0.1 * (i % 2), 0.0] for i in range(30)]
    studio.change(strokes=[line], samples=10, components=12)
    studio.tick(0.02)
    assert studio.complaint or studio.imitation
    studio.change(**{name: getattr(drawn.problem(), name) for name in ("strokes", "samples", "components")})
    Instant.made[0].out.insert(0, (1, Failed("of an earlier drawing")))
    assert studio.imitating
    studio.tick(0.02)
    assert studio.complaint == "" and studio.imitation is not None


def test_an_imitator_that_dies_is_made_anew(studio):
    before = studio.imitation
    studio.change(components=2)
    Instant.made[0].dead, Instant.made[0].out = True, []
    studio.tick(0.02)
    studio.tick(0.02)
    assert studio.imitation is not before and studio.imitation.policy.n_components == 2 and len(Instant.made) == 2


def test_everybody_who_looks_hears_of_changes(studio):
    views = [Looking(), Looking()]
    studio.views += views
    studio.change(components=2)
    studio.tick(0.02)
    for view in views:
        assert "problem" in view.seen and "imitation" in view.seen


def test_both_learners_learn_their_own_run_and_a_changed_problem_stops_them(tmp_path, studio):
    studio.change(learners=[*studio.problem.learners, {"optimizer": "adam", "updates": 5}])
    studio.go(30.0)
    learners = Instant.made[1:]
    assert [worker.told for worker in learners] == [[("go", 30.0)]] * 2
    folders = [worker.arguments[0] for worker in learners]
    assert [Problem.read(folder / "problem.json").learners for folder in folders] == [
        (studio.problem.learners[0],),
        (studio.problem.learners[1],),
    ]
    for worker in learners:
        worker.out.append(picture(studio))
    studio.tick(0.02)
    assert studio.policy() is studio.fresh(0).policies[1] or studio.fresh(0).best == 1
    studio.change(via_points=[])
    assert all(worker.told[-1] == ("pause", None) for worker in learners)
    assert studio.fresh(0) is None and studio.sides[0].stale(studio.problem)
    studio.undo()
    assert studio.fresh(0) is not None
    studio.go(5.0)  # the same problem goes on
    assert len(Instant.made) == 3 and learners[0].told[-1] == ("go", 5.0)
    assert [s.folder for s in Studio(tmp_path / "studio").sides] == folders


def test_reset_begins_anew_and_keeps_the_run_before(studio):
    studio.go(30.0)
    first = studio.sides[0].folder
    studio.reset()
    assert studio.sides[0].folder != first and (first / "options.json").is_file()
    assert Instant.made[1].dead and Instant.made[2].told == []
    studio.step()
    studio.pause()
    assert Instant.made[2].told == [("step", None), ("pause", None)]


def test_a_learner_that_was_killed_says_so_and_goes_on_where_it_was(studio):
    studio.go(30.0)
    Instant.made[1].out.append(picture(studio))
    studio.tick(0.02)
    Instant.made[1].dead = True
    studio.tick(0.02)
    assert "after 3 updates is kept" in studio.sides[0].complaint and not studio.sides[0].running
    folder = studio.sides[0].folder
    studio.go(30.0)
    assert Instant.made[2].arguments == (folder,) and Instant.made[2].told == [("go", 30.0)]
    assert studio.sides[0].complaint == ""


def test_nothing_drawn_is_nothing_to_learn_or_to_push(studio):
    studio.change(strokes=[])
    for call in (lambda: studio.go(1.0), studio.step, studio.reset, lambda: studio.push("open", 100.0)):
        with pytest.raises(InvalidArgumentError, match="draw"):
            call()


def test_the_mass_is_pulled_and_let_go(studio):
    studio.push("closed", 100.0)
    studio.pull([0.9, 0.9])
    assert studio.pushed.hand.tolist() == [0.9, 0.9]
    before = studio.pushed.t
    studio.tick(0.05)
    assert studio.pushed.t == pytest.approx(before + 0.05)
    studio.pull(None)
    assert studio.pushed.hand is None
    studio.nudge((1, 0))
    assert studio.pushed.hand is not None
    for _ in range(10):
        studio.tick(0.05)
    assert studio.pushed.hand is None
    studio.let_go()
    studio.pull([0.0, 0.0])
    studio.nudge((0, 1))
    assert studio.pushed is None


def test_undo_keeps_every_other_step_beside_those_of_a_slider(studio):
    studio.adjust(components=5)
    studio.change(via_points=[])
    studio.adjust(components=6)  # another step: something else was between
    studio.undo()
    assert studio.problem == drawn.problem(components=5, via_points=[])
    studio.undo()
    assert studio.problem == drawn.problem(components=5)
    studio.adjust(components=5)  # no change at all
    studio.undo()
    assert studio.problem == drawn.problem()
    studio.adjust(components=7)
    studio.undo()
    studio.adjust(components=8)
    studio.undo()
    assert studio.problem == drawn.problem()


@pytest.mark.parametrize("forgotten", [True, False])
def test_a_stroke_that_is_given_up_leaves_the_system_of_the_problem(studio, forgotten):
    before = studio.imitation.policy.pack()
    studio.draw([(t, x1, x2 + 1) for t, x1, x2 in drawn.stroke()], False)
    studio.tick(0.02)
    assert not studio.imitation.policy.pack().equal(before) and studio.imitating
    if forgotten:
        studio.forget()
    else:
        with pytest.raises(InvalidArgumentError, match="too short"):
            studio.draw([(5.0, 0.1, 0.1)], True)
    studio.tick(0.02)
    assert studio.imitation.policy.pack().equal(before) and not studio.imitating
    assert studio.problem == drawn.problem()


def test_a_system_of_an_earlier_drawing_is_not_given_away(studio):
    studio.change(components=2)
    assert studio.imitating
    with pytest.raises(InvalidArgumentError, match="still being imitated"):
        studio.settled()
    studio.tick(0.02)
    assert studio.settled()[0].n_components == 2


def test_another_name_keeps_what_is_learned(studio):
    studio.go(30.0)
    Instant.made[1].out.append(picture(studio))
    studio.tick(0.02)
    studio.change(name="Another name")
    assert studio.fresh(0) is not None and Instant.made[1].told == [("go", 30.0)]


def test_a_changed_problem_stops_a_learner_that_has_said_nothing_yet(studio):
    studio.go(30.0)
    studio.change(via_points=[])
    assert Instant.made[1].told == [("go", 30.0), ("pause", None)]
    studio.change(via_points=[[0.1, 0.1]])
    assert len(Instant.made[1].told) == 2


def test_a_second_learner_that_is_switched_off_pauses_and_comes_back(tmp_path, studio):
    one = studio.problem.learners
    studio.change(learners=[*one, {"optimizer": "adam", "updates": 5}])
    studio.go(30.0)
    Instant.made[2].out.append(picture(studio))
    studio.tick(0.02)
    studio.change(learners=one)
    first, second = Instant.made[1:]
    assert second.told == [("go", 30.0), ("pause", None)] and not second.dead  # nobody waits for it to end
    assert first.told == [("go", 30.0)] and studio.fresh(1) is None and "B" not in words(studio)
    studio.go(20.0)
    assert second.told[-1] == ("pause", None) and not studio.sides[1].running
    n = len(Instant.made)
    Studio(tmp_path / "studio")
    assert len(Instant.made) == n + 2  # one that imitates, one that learns
    studio.undo()
    assert studio.fresh(1) is not None
    studio.go(30.0)
    assert len(Instant.made) == n + 2 and second.told[-1] == ("go", 30.0)


WRONG = [
    ({"seed": "abc"}, "option seed cannot be 'abc'; it has to be a whole number"),
    ({"seed": None}, "option seed cannot be None"),
    ({"seed": -1}, "got -1"),
    ({"rollouts": 0}, "at least 1, got 0"),
    ({"rollouts": 2.5}, "option rollouts cannot be 2.5"),
    ({"updates": "many"}, "option updates cannot be 'many'"),
    ({"updatse": 3}, "Did you mean 'updates'"),
    ({"scale": 0.0}, "--scale has to be positive"),
    ({"optimizer": "newton"}, "unknown optimizer 'newton'"),
]


@pytest.mark.parametrize("learner, said", WRONG)
def test_options_of_a_learner_that_do_not_fit_are_refused_and_change_nothing(tmp_path, studio, learner, said):
    studio.go(30.0)
    Instant.made[1].out.append(picture(studio))
    studio.tick(0.02)
    folder, folders = studio.sides[0].folder, sorted(tmp_path.rglob("problem.json"))
    wrong = replace(studio.problem, learners=[learner])
    with pytest.raises((InvalidArgumentError, UnknownNameError), match=said):
        studio.put(wrong)
    with pytest.raises((InvalidArgumentError, UnknownNameError)):
        studio.change(learners=[*studio.problem.learners, learner])
    with pytest.raises((InvalidArgumentError, UnknownNameError)):
        studio.sides[0].begin(wrong)
    assert studio.problem == drawn.problem() and studio.fresh(0) is not None
    assert studio.sides[0].folder == folder and sorted(tmp_path.rglob("problem.json")) == folders


def test_what_was_wrong_with_an_earlier_problem_is_not_said_of_this_one(studio):
    studio.go(30.0)
    Instant.made[1].out.append(Failed("--optimizer adam cannot do this"))
    studio.tick(0.02)
    assert "adam cannot" in words(studio)
    studio.change(via_points=[])
    assert "adam cannot" not in words(studio) and "earlier version" in words(studio)
    studio.undo()
    assert "adam cannot" in words(studio)


def test_when_all_updates_are_made_it_is_said(studio):
    studio.go(30.0)
    Instant.made[1].out.append(picture(studio)._replace(done=4))
    studio.tick(0.02)
    assert "all updates are made" in words(studio)


def test_a_run_whose_folder_is_gone_begins_anew(tmp_path, studio):
    studio.go(30.0)
    shutil.rmtree(studio.sides[0].folder)
    again = Studio(tmp_path / "studio")
    assert again.problem == studio.problem and again.sides[0].folder is None
    again.go(30.0)
    assert again.sides[0].folder.is_dir()


@pytest.mark.parametrize(
    "name, stem",
    [("An S!", "an_s"), ("Übung für Zoë", "ubung_fur_zoe"), ("日本", "drawing"), ("../../etc", "etc"), ("", "drawing")],
)
def test_any_name_is_one_of_a_file(name, stem):
    assert side.stem(drawn.problem(name=name)) == stem
