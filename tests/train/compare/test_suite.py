"""The tables of the documentation: from outcomes that are known, into pages with a place for them, and from real runs."""

import pytest

from tests.motions import Short
from torchds.errors import InvalidArgumentError
from train.compare import command, suite
from train.compare.command import KNOWN, Compare
from train.compare.report import Outcome
from train.compare.suite import Made, Part


def outcome(problem, label, *medians, step=10, **given):
    record = {
        "cost": [[m, m, m] for m in medians],
        "rollouts": [step * i for i in range(len(medians))],
        "seconds": 30.0,
    }
    return Outcome(problem, label, record, **given)


def made(table="learners", noise=0.0):
    rows = [
        outcome("p", "pibb", 9.0, 5.0, 2.0),
        outcome("p", "surrogate, trajectory", 9.0, 2.0, 0.5),
        outcome("q", "pibb", 4.0, 3.0, 1.0, step=20),
        outcome("q", "surrogate, trajectory", 4.0, 3.5, 1.5),
    ]
    return Made(Part(table, ("p", "q"), (suite.PAPER, suite.RECOMMENDED), noise), rows)


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_the_recommended_learner_stands_beside_the_paper():
    assert cells(suite.learners([made(), made(noise=0.5)])) == [
        ["p", "0", "9", "2 after 20", "10", "0.5"],
        ["q", "0", "4", "1 after 40", "never", "1.5"],
        ["p", "0.5", "9", "2 after 20", "10", "0.5"],
        ["q", "0.5", "4", "1 after 40", "never", "1.5"],
    ]


def test_methods_stand_in_lines_and_problems_in_columns():
    one = made("optimizers")
    one.rows.append(Outcome("q", "adam", refused="has no gradient"))
    assert cells(suite.beside([one])) == [
        ["pibb", "2 (20)", "1 (40)"],
        ["surrogate, trajectory", "0.5 (10)", "1.5"],
        ["adam", "", "refused"],
    ]
    head = suite.beside([made("noise", 0.1), made("noise", 0.5)]).splitlines()[0]
    assert "p, noise 0.1" in head and "q, noise 0.5" in head


def test_every_part_has_a_table_and_problems_that_can_be_made():
    parts = list(suite.parts())
    assert {part.table for part in parts} == set(suite.TABLES)
    assert {problem for part in parts for problem in part.problems} <= set(KNOWN)
    assert all(suite.PAPER in part.methods for part in parts)


def test_tables_go_between_their_marks_or_nowhere(tmp_path):
    page, other = tmp_path / "a.md", tmp_path / "b.md"
    page.write_text(
        "# A\n\n<!-- suite: one -->\nold\n<!-- suite end -->\n\nmore\n\n<!-- suite: two -->\n<!-- suite end -->\n"
    )
    other.write_text("# B\n")
    suite.keep(tmp_path, {"one": r"| \1 |", "two": "second"})
    text = page.read_text()
    assert "old" not in text and "more" in text and other.read_text() == "# B\n"
    assert text.index(r"| \1 |") < text.index("more") < text.index("second")
    suite.keep(tmp_path, {"one": "| new |"})
    with pytest.raises(InvalidArgumentError, match="suite: three"):
        suite.keep(tmp_path, {"one": "lost", "three": "x"})
    assert "| new |" in page.read_text() and "second" in page.read_text()


@pytest.mark.slow
def test_one_command_makes_the_tables_of_real_runs(tmp_path, monkeypatch, capsys):
    short = Short()
    monkeypatch.setattr(command, "made", lambda options: short)
    monkeypatch.setattr(
        suite,
        "parts",
        lambda: iter(
            Part(table, ("via_point-N",), (suite.PAPER, suite.RECOMMENDED), 0.1 * (table == "noise"))
            for table in suite.TABLES
        ),
    )
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "page.md").write_text("".join(f"<!-- suite: {name} -->\n<!-- suite end -->\n" for name in suite.TABLES))
    small = {"runs": 3, "updates": 2, "factors": (1.0,), "tuning_runs": 4, "logdir": tmp_path / "logs"}
    folder = Compare(suite="docs", keep=docs, **small).main()
    text = (folder / "suite.md").read_text()
    command_line = "`python -m train compare --suite docs --runs 3 --seed 0 --updates 2 --factors 1.0 --tuning-runs 4`"
    assert text.count(command_line) == len(suite.TABLES)
    assert all(table in (docs / "page.md").read_text() for table in text.split("\n\n") if table.startswith("| "))
    assert (
        len(list((tmp_path / "logs" / "compare" / "runs" / "via_point").iterdir())) == 4
    )  # two methods, with and without noise


def test_the_pages_have_a_place_for_every_table():
    from pathlib import Path

    docs = Path(__file__).parents[3] / "docs"
    text = "".join(path.read_text() for path in docs.glob("*.md"))
    for name in suite.TABLES:
        assert text.count(f"<!-- suite: {name} -->\n") == 1, name


def test_agents_that_are_there_are_not_learned_again(tmp_path, monkeypatch):
    class Agent:
        def __init__(self, environment, seed, updates, logdir):
            self.folder = logdir / "via_point" / "ppo" / f"now-{seed}"

        def main(self):
            self.folder.mkdir(parents=True)
            (self.folder / "results.json").write_text("{}")
            return self.folder

    monkeypatch.setattr(suite, "DeepRL", Agent)
    first = suite.deep(tmp_path, "ViaPointN", 3, 0)
    monkeypatch.setattr(suite, "DeepRL", None)
    assert suite.deep(tmp_path, "ViaPointN", 3, 0) == first
    for other in ((4, 0), (3, 10)):
        with pytest.raises(TypeError):  # nothing of another budget or another seed is there
            suite.deep(tmp_path, "ViaPointN", *other)
    monkeypatch.setattr(suite, "DeepRL", Agent)
    own = suite.deep(tmp_path, "ViaPointN", None, 0)
    assert own != first and own == suite.deep(tmp_path, "ViaPointN", 50, 0)
