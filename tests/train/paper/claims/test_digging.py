"""The claims about digging, on an experiment that was made up to agree, and to disagree in one figure."""

import json

import pytest

from train.paper.claims import digging
from train.paper.claims.base import HELD, NOT_HELD, NOT_MEASURED, verdict
from train.paper.claims.command import CLAIMS
from train.paper.measured.base import Setting


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
    for run in range(5):
        content["trials"][f"{name}-{run}"][term] = [value + 0.001 * i for i in range(5)]
    path.write_text(json.dumps(content))
    assert verdict(CLAIMS[fails].measure(Setting(20, 0, dug))) == NOT_HELD


def test_fewer_runs_than_a_test_needs_are_not_judged(dug):
    path = dug.folder / "trials.json"
    content = json.loads(path.read_text())
    content["trials"] = {name: terms for name, terms in content["trials"].items() if not name.endswith("-4")}
    path.write_text(json.dumps(content))
    verdicts = {claim.id: verdict(claim.measure(Setting(20, 0, dug))) for claim in digging.CLAIMS}
    uniform = {"digging-soft-load", "digging-soft-force", "digging-best-uniform"}
    curves = {"digging-stiff-gravel"}
    assert {name for name, found in verdicts.items() if found == NOT_MEASURED} == set(verdicts) - uniform - curves
