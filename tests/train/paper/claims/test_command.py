"""python -m train claims: every claim is complete, the rules decide as they say, and the tables show what was measured."""

import csv
import itertools
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.exploration import Stable
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass
from train.folder import Interrupted
from train.paper.claims import base, digging, exploration, impedance, via_points
from train.paper.claims import command as claims
from train.paper.claims.base import HELD, IN_PART, NOT_HELD, NOT_MEASURED, Check, Claim, Setting, verdict
from train.paper.claims.command import CLAIMS, Claims
from train.paper.figures.base import via_distances
from train.paper.figures.impedance import stiffness_by_half
from train.paper.measured.digging import UNIFORM, Experiment

SECTIONS = (via_points, exploration, impedance, digging)


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


# ------------------------------------------------------------------ what is there


def test_every_claim_is_complete_and_has_a_name_of_its_own():
    assert len(CLAIMS) == sum(len(section.CLAIMS) for section in SECTIONS)
    for name, claim in CLAIMS.items():
        assert name == claim.id and re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name)
        assert re.match(r"[3-6](\.\d)?(,|$)", claim.where)
        for sentence in (claim.says, claim.rule):
            assert sentence[0].isupper() and sentence.endswith(".") and len(sentence) > 10
        assert callable(claim.measure)


def test_every_figure_that_says_something_has_a_claim():
    figures = {int(n) for claim in CLAIMS.values() for n in re.findall(r"Fig\. (\d+)", claim.where)}
    assert figures == {2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 16, 17}


# ------------------------------------------------------------------ rules


@pytest.mark.parametrize(
    ("held", "expected"),
    [([], NOT_MEASURED), ([1], HELD), ([1, 1, 1], HELD), ([1, 0], IN_PART), ([0, 0, 1], IN_PART), ([0, 0], NOT_HELD)],
)
def test_the_verdict(held, expected):
    assert verdict([Check("", bool(h), 1) for h in held]) == expected


def test_lower_has_the_p_of_all_permutations(randn):
    a, b = randn(5).numpy(), randn(5).numpy() + 1.0
    pooled = np.concatenate([a, b])

    def wins(chosen):
        rest = [i for i in range(10) if i not in chosen]
        return sum(pooled[i] > pooled[j] for i in chosen for j in rest)

    splits = [wins(chosen) for chosen in itertools.combinations(range(10), 5)]
    check = base.lower("x", a, b)
    assert check.p == pytest.approx(np.mean([w <= wins(range(5)) for w in splits]), rel=1e-9)
    assert check.n == 5


def test_lower_needs_a_test_and_an_effect(randn):
    small, large = randn(2000).numpy(), randn(2000).numpy()
    trifling = base.lower("x", small, large + 0.2)
    assert trifling.p < 1e-4 and not trifling.holds
    few = base.lower("x", [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    assert few.effect == -1.0 and not few.holds
    assert base.lower("x", small[:20], small[:20] + 2).holds
    assert not base.lower("x", small[:20] + 2, small[:20]).holds


@pytest.mark.parametrize("falls", [True, False])
def test_changes_is_a_sign_test(falls):
    before, sign = np.arange(12.0), -1 if falls else 1
    after = before + sign * 0.5
    check = base.changes("x", before, after, falls=falls)
    assert check.holds and check.p == pytest.approx(0.5**12) and check.effect == sign
    assert not base.changes("x", before, after, falls=not falls).holds
    after[:3] = before[:3]  # ties say nothing
    assert base.changes("x", before, after, falls=falls).p == pytest.approx(0.5**9)
    assert base.changes("x", 3.0, np.full(5, 3.0), falls=falls).p == 1.0
    assert "x: 3 → 3" in base.changes("x", 3.0, np.full(5, 3.0), falls=falls).what
    assert not base.changes("x", before[:6], before[:6] + sign, falls=falls).holds  # 1/64 > 0.01


def test_alike_holds_for_one_distribution_and_not_for_two(randn):
    a = randn(40).numpy()
    assert base.alike("x", a, a + 0.01).holds
    assert not base.alike("x", a, a + 2).holds
    assert not base.alike("x", a + 2, a).holds


def test_numbers_hold_within_their_bounds_and_counts_from_their_share():
    assert [base.within("x", v, 1.0, 2.0).holds for v in (0.9, 1.0, 1.5, 2.1, np.nan)] == [0, 1, 1, 0, 0]
    assert base.within("x", [0.0, 1.5, 9.0], 1.0, 2.0).holds  # the median
    assert [base.counted("x", k, 20, 0.9).holds for k in (17, 18, 20)] == [0, 1, 1]
    assert [base.counted("x", k, 20).holds for k in (19, 20)] == [0, 1]


def test_the_early_share_of_a_line_is_a_quarter_and_that_of_a_decay_is_more():
    t = np.linspace(0, 1, 41)[:, None]
    assert base.early_share(3 - 2 * t) == pytest.approx(0.25)
    assert base.early_share(np.exp(-5 * t)) == pytest.approx((1 - np.exp(-1.25)) / (1 - np.exp(-5)))


# ------------------------------------------------------------------ measurements


@pytest.mark.parametrize(("factor", "fails"), [(1.01, "stable with"), (0.98, "unstable with")])
def test_a_shrinkage_that_is_off_is_found_out(factor, fails, monkeypatch, tmp_path):
    setting = Setting(3, 0, Experiment(tmp_path, 0))
    assert all(check.holds for check in exploration.shrinkage(setting))
    true = Stable.shrinkage
    monkeypatch.setattr(Stable, "shrinkage", lambda A, S: factor * true(A, S))
    failed = [check.what for check in exploration.shrinkage(setting) if not check.holds]
    assert failed and any(fails in what for what in failed)


def test_the_overshoot_is_that_of_the_printed_equations():
    s, m, dt = 30.0, 1.0, 0.1
    D = 2 * np.sqrt(s * m)
    state, highest = np.zeros(2), 0.0
    for _ in range(impedance.LONG):
        # x' = x + v' dt, v' = v + (s (1 − x') − D v') dt / m
        matrix = np.array([[1.0, -dt], [s * dt / m, 1 + D * dt / m]])
        state = np.linalg.solve(matrix, state + np.array([0.0, s * dt / m]))
        highest = max(highest, state[0])
    found = impedance.overshoot(ImpedanceControlled(PointMass(m, 0.0)), torch.tensor([[s]], dtype=torch.float64), dt)
    assert float(found) == pytest.approx(highest - 1, abs=1e-12)
    stiff = torch.tensor([[1000.0]], dtype=torch.float64)
    assert float(impedance.overshoot(ImpedanceControlled(PointMass(m, 0.0), form="explicit"), stiff, dt)) == np.inf


def test_distances_and_stiffness_by_half_are_those_of_loops(randn):
    x, points = randn(3, 6, 2), randn(4, 2)
    found = via_distances(x, points)
    for i, l in itertools.product(range(3), range(4)):
        assert float(found[i, l]) == pytest.approx(min(float((x[i, t] - points[l]).norm()) for t in range(1, 6)))
    s, at = randn(3, 2, 7, 2).abs(), randn(3, 2, 7, 2) - 5
    inside, outside = stiffness_by_half(SimpleNamespace(plant=SimpleNamespace(stiffness=s, x=at)))
    for run, d in itertools.product(range(3), range(2)):
        halves = {True: [], False: []}
        for e, t in itertools.product(range(2), range(1, 7)):
            halves[bool(at[run, e, t, 0] > -5)].append(float(s[run, e, t, d]))
        assert float(inside[run, d]) == pytest.approx(np.mean(halves[True]))
        assert float(outside[run, d]) == pytest.approx(np.mean(halves[False]))


# ------------------------------------------------------------------ digging


@pytest.fixture
def dug(tmp_path):
    """An experiment that never was: whose best uniform stiffness is 250, and whose learner does what the paper says."""
    jitter = np.array([-0.02, -0.01, 0.0, 0.01, 0.02])

    def trials(total, load, force, stiffness):
        means = {
            "total": total,
            "gravel/load": load,
            "force": force,
            "force/peak": 9 * force,
            "stiffness/mean": stiffness,
        }
        return {name: (mean + jitter).tolist() for name, mean in means.items()}

    measured = {
        f"uniform-{s:g}": trials(2 + abs(s - 250) / 100, load=s / 100, force=s / 200, stiffness=s) for s in UNIFORM
    }
    measured["as in the paper-150"] = trials(1.0, load=4.0, force=0.8, stiffness=220)
    measured["as in the paper-400"] = trials(1.5, load=4.0, force=0.9, stiffness=270)
    experiment = Experiment(tmp_path / "lwr_digging" / "experiment-0", 0)
    experiment.folder.mkdir(parents=True)
    (experiment.folder / "trials.json").write_text(json.dumps({"trials": measured}))
    folder = experiment.place("as in the paper", 400)
    folder.mkdir()
    gravel = [[g] for g in (-2.0, -1.5, -1.2, -1.4, -1.9, -2.1)]
    (folder / "results.json").write_text(json.dumps({"terms": {"gravel": gravel}}))
    return experiment


def test_the_digging_claims_hold_for_an_experiment_that_agrees(dug):
    setting = Setting(20, 0, dug)
    assert {claim.id: verdict(claim.measure(setting)) for claim in digging.CLAIMS} == {
        claim.id: HELD for claim in digging.CLAIMS
    }


@pytest.mark.parametrize(
    ("name", "term", "value", "fails"),
    [
        ("uniform-400", "gravel/load", 1.0, "digging-soft-load"),
        ("as in the paper-150", "stiffness/mean", 140.0, "digging-soft-stiffens"),
        ("as in the paper-150", "force", 1.0, "digging-soft-same-force"),
        ("as in the paper-150", "gravel/load", 1.5, "digging-soft-gravel"),
        ("as in the paper-400", "stiffness/mean", 410.0, "digging-stiff-softens"),
        ("as in the paper-400", "force", 2.1, "digging-stiff-force"),
        ("uniform-100", "total", 1.8, "digging-best-uniform"),
        ("uniform-450", "total", 0.5, "digging-below-uniform"),
    ],
)
def test_a_digging_claim_fails_with_its_figure(dug, name, term, value, fails):
    path = dug.folder / "trials.json"
    content = json.loads(path.read_text())
    content["trials"][name][term] = [value + 0.001 * i for i in range(5)]
    path.write_text(json.dumps(content))
    assert verdict(CLAIMS[fails].measure(Setting(20, 0, dug))) == NOT_HELD


def test_without_an_experiment_the_rows_say_how_to_get_it(tmp_path, capsys):
    rows = Claims(only=tuple(claim.id for claim in digging.CLAIMS), logdir=tmp_path).main()
    assert {verdict(row.checks) for row in rows} == {NOT_MEASURED}
    command = "python -m train claims --only digging-best-uniform --runs 20 --seed 0 --digging True"
    for text in (capsys.readouterr().out, (tmp_path / "claims" / "claims.md").read_text()):
        assert "not measured here" in text and command in text
    assert {row["verdict"] for row in read(tmp_path / "claims" / "claims.csv")} == {NOT_MEASURED}


# ------------------------------------------------------------------ the command


@pytest.fixture
def two_updates(monkeypatch):
    """Two updates, whatever the task says."""
    monkeypatch.setattr("train.learning.learner.n_updates", lambda options, task: 2)
    base.shared.cache_clear()
    yield
    base.shared.cache_clear()


def test_two_claims_are_measured_and_all_tables_agree(two_updates, tmp_path, capsys):
    names = ("pibb-below-pi2", "noise-within-half")
    kept = tmp_path / "docs" / "claims.md"
    rows = Claims(only=names, runs=3, logdir=tmp_path, keep=kept).main()
    assert [row.claim.id for row in rows] == list(names)
    page = kept.read_text()
    assert page == (tmp_path / "claims" / "claims.md").read_text()
    assert "python -m train claims --only pibb-below-pi2 noise-within-half --runs 3 --seed 0" in page
    assert "torch" in page and re.search(r"on \d{4}-\d\d-\d\d with", page) and "this is a trial" in page
    records, shown = read(tmp_path / "claims" / "claims.csv"), capsys.readouterr().out
    assert len(records) == sum(len(row.checks) for row in rows) == 4
    for name in names:
        mine = [record for record in records if record["id"] == name]
        (line,) = [line for line in page.splitlines() if line.startswith(f"| `{name}`")]
        assert {record["verdict"] for record in mine} == {line.rsplit("**", 2)[1]}
        for record in mine:
            assert record["check"] in line and record["check"] in shown
            assert not record["p"] or f"δ = {record['delta']}, p = {record['p']}" in line
            assert record["command"] == f"python -m train claims --only {name} --runs 3 --seed 0"
            assert None not in record and record["says"] and record["rule"]
        assert line.count("<br>") == len(mine) - 1


@pytest.fixture
def made_up(monkeypatch):
    """Two claims, the second of which is interrupted as often as `stop` says; returns what was measured."""
    asked, stop = [], []

    def first(setting):
        asked.append(("first", setting.runs, setting.seed))
        return [Check("one | two", np.bool_(True).item(), 3, 0.5, 0.25)]

    def second(setting):
        if stop:
            raise stop.pop()
        asked.append(("second", setting.runs, setting.seed))
        return [Check("three", False, 3)]

    claim = Claim("first", "3", "A sentence.", "A rule.", first)
    monkeypatch.setattr(claims, "CLAIMS", {"first": claim, "second": replace(claim, id="second", measure=second)})
    return asked, stop


def test_an_interrupted_command_goes_on_where_it_was(made_up, tmp_path):
    asked, stop = made_up
    stop.append(KeyboardInterrupt())
    with pytest.raises(Interrupted, match="the same command continues"):
        Claims(logdir=tmp_path).main()
    assert asked == [("first", 20, 0)]
    first = Claims(logdir=tmp_path).main()
    assert asked == [("first", 20, 0), ("second", 20, 0)]
    assert Claims(logdir=tmp_path).main() == first  # from what is kept
    assert len(asked) == 2
    assert "one \\| two" in (tmp_path / "claims" / "claims.md").read_text()


def test_other_options_and_other_code_are_measured_again(made_up, tmp_path, monkeypatch):
    asked, _ = made_up
    for options in ({}, {"runs": 5}, {"seed": 1}):
        Claims(only=("first",), logdir=tmp_path, **options).main()
    assert asked == [("first", 20, 0), ("first", 5, 0), ("first", 20, 1)]
    monkeypatch.setattr(claims, "source", lambda: "changed")
    Claims(only=("first",), logdir=tmp_path, seed=1).main()
    assert len(asked) == 4


def test_what_cannot_be_measured_is_refused_before_anything_is_made(tmp_path):
    with pytest.raises(UnknownNameError, match=r"^unknown claim 'trade-of'\. Did you mean 'trade-off'"):
        Claims(only=("trade-of",), logdir=tmp_path / "new").main()
    with pytest.raises(InvalidArgumentError, match="--runs has to be at least 1, got 0"):
        Claims(runs=0, logdir=tmp_path / "new").main()
    assert not (tmp_path / "new").exists()
