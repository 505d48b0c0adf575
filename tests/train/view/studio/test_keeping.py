"""What is taken along from the page, and what is shown of it."""

import io
import xml.etree.ElementTree as ET

import matplotlib.pyplot as plt
import pytest
import torch

pytest.importorskip("nicegui")

from tasks.sketch import Problem, Sketch
from tests import drawn
from tests.train.view.studio.test_state import Instant, Studio, imitator, picture, side
from torchds import load, load_policy
from torchds.errors import InvalidArgumentError
from train.view.studio import keeping, showing
from train.view.studio.learning import Picture


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imitator, "Worker", Instant)
        patch.setattr(side, "Worker", Instant)
        studio = Studio(tmp_path_factory.mktemp("logs") / "studio")
        studio.put(drawn.problem())
        studio.tick(0.02)
        yield studio


def test_files_are_read_as_what_was_on_the_page(tmp_path, studio):
    made = {".json": keeping.problem, ".npz": keeping.demonstrations, ".pt": keeping.policies}
    for ending, make in made.items():
        (tmp_path / f"it{ending}").write_bytes(make(studio))
    assert Problem.read(tmp_path / "it.json") == studio.problem
    for read, own in zip(load(tmp_path / "it.npz"), studio.problem.demonstrations(), strict=True):
        torch.testing.assert_close(read.x, own.x)
    policy = load_policy(tmp_path / "it.pt")
    torch.testing.assert_close(policy.pack(), studio.imitation.policy.pack(), rtol=0, atol=0)


def test_pictures_are_what_their_names_say(studio):
    assert ET.fromstring(keeping.svg(studio)).tag.endswith("svg")
    assert plt.imread(io.BytesIO(keeping.png(studio))).std() > 0.05


def test_the_script_is_that_of_the_problem_which_is_kept_for_it(studio):
    text = keeping.program(studio).decode()  # what it gives: tests/tasks/sketch/test_script.py
    compile(text, "script.py", "exec")
    (kept,) = [path for path in (studio.folder / "problems").iterdir() if str(path.resolve()) in text]
    assert Problem.read(kept) == studio.problem


def test_a_script_keeps_its_problem_whatever_it_is_called(studio):
    before = studio.problem
    studio.change(name="State")
    kept = (studio.folder / "state.json").read_text()
    first = keeping.program(studio)
    assert (studio.folder / "state.json").read_text() == kept
    assert keeping.program(studio) == first  # the same problem, the same file
    named = studio.problem
    studio.change(via_points=[])
    assert keeping.program(studio) != first
    assert Problem.read(studio.folder / "problems" / "state.json") == named
    studio.put(before)
    studio.tick(0.02)


def test_without_a_drawing_there_is_nothing_to_take(studio):
    before = studio.problem
    studio.change(strokes=[])
    for make in (keeping.policies, keeping.svg, keeping.demonstrations):
        with pytest.raises(InvalidArgumentError, match=r"draw|nothing"):
            make(studio)
    assert showing.imitated(studio) == {"imitated": [], "gaussians": []} and showing.field(studio, 0, 1.6) == []
    assert showing.scenery(studio, 1.6)["start"] == []
    studio.put(before)
    studio.tick(0.02)


def test_the_table_shows_the_problem_its_system_and_what_is_learned(studio):
    scenery = showing.scenery(studio, 1.6)
    assert scenery["via"] == ((-0.3, 0.3),) and len(scenery["strokes"]) == 2
    torch.testing.assert_close(
        torch.tensor(scenery["start"]).double(), Sketch.of(studio.problem)().motion().x0, atol=1e-4, rtol=0
    )
    assert len(showing.imitated(studio)["gaussians"]) == 4
    arrows = torch.tensor(showing.field(studio, 0, 1.6), dtype=torch.float64)
    middle, along = arrows.mean(1), arrows[:, 1] - arrows[:, 0]
    v = studio.imitation.policy(middle).detach()
    fast = v.norm(dim=-1) > 0.1
    cosine = torch.nn.functional.cosine_similarity(along, v)[fast]
    assert cosine.min() > 0.99
    assert showing.learned(studio, 0, 1.6)["motion"] == [] and showing.series(studio) == []
    studio.sides[0].problem, studio.sides[0].picture = studio.sides[0].wanted(studio.problem), picture(studio)
    layers = showing.learned(studio, 0, 1.6)
    assert len(layers["motion"]) == 2 and len(layers["trials"]) == 2
    (line,) = showing.series(studio)
    assert line["name"] == "total, A: pibb" and line["data"] == [[0, 4.0], [6, 3.0], [12, 2.0], [18, 1.0]]
    assert isinstance(studio.sides[0].picture, Picture)


def test_costs_that_have_no_logarithm_leave_a_gap(studio):
    gaps = picture(studio)._replace(curves={"total": [1.0, 0.0, float("inf"), 2.0], "control": [0.0] * 4})
    studio.sides[0].problem, studio.sides[0].picture = studio.sides[0].wanted(studio.problem), gaps
    total, control = showing.series(studio)
    assert total["data"] == [[0, 1.0], [18, 2.0]] and control["data"] == []


def test_numbers_that_are_none_do_not_reach_the_page():
    assert showing.plain(torch.tensor([float("nan"), 1.23456789])) == [0.0, 1.2346]


def test_small_worlds_are_shown_as_exactly_as_large_ones():
    x = torch.tensor([1.23456789e-3], dtype=torch.float64)
    assert showing.plain(x, (-0.001, 0.001, -0.001, 0.001)) == [0.0012346]
    assert showing.plain(1e6 * x, (-1000.0, 1000.0, -1000.0, 1000.0)) == [1234.6]


def test_the_mass_is_shown_with_what_pulls_it(studio):
    assert showing.mass(studio) is None
    studio.push("closed", 100.0)
    studio.pull([0.5, 0.5])
    studio.tick(0.1)
    shown = showing.mass(studio)
    assert shown["hand"] == [0.5, 0.5] and shown["trail"] and len(shown["at"]) == 2
    studio.let_go()
