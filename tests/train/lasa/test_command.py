import csv
import json

import matplotlib.image
import pytest
import torch

from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError, UnknownNameError
from train.lasa.command import METHODS, MOTIONS, BenchmarkLasa, share_at_goal
from train.lasa.report import PUBLISHED, PUBLISHED_SEDS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    logdir = tmp_path_factory.mktemp("logs")
    BenchmarkLasa(repetitions=1, motions=("Worm", "Line"), logdir=logdir).main()
    return logdir / "benchmark_lasa"


def rows(folder, name):
    with (folder / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def test_there_are_26_single_motions_and_each_has_its_published_error():
    assert len(MOTIONS) == 26
    assert set(PUBLISHED_SEDS) == set(MOTIONS)
    assert sum(PUBLISHED_SEDS.values()) / 26 == pytest.approx(PUBLISHED["SEDS"][0], abs=0.01)


def test_every_fit_has_its_row_and_the_means_are_those_of_the_fits(folder):
    fits, by_method, by_motion = (rows(folder, name) for name in ("fits", "by_method", "by_motion"))
    assert [(row["method"], row["motion"]) for row in fits] == [(m, n) for m in METHODS for n in ("Worm", "Line")]
    assert [row["method"] for row in by_method] == list(METHODS)
    assert len(by_motion) == 8
    for row in by_method:
        own = [float(fit["rmse"]) for fit in fits if fit["method"] == row["method"]]
        assert float(row["rmse"]) == pytest.approx(sum(own) / 2)
    assert json.loads((folder / "options.json").read_text())["options"]["motions"] == ["Worm", "Line"]


def test_stable_fits_are_certified_reach_the_goal_from_everywhere_and_are_accurate(folder):
    for row in rows(folder, "fits"):
        assert 0.0 < float(row["rmse"]) < 8.0  # mm/s; the published average of SEDS is 6.3
        assert 0.0 < float(row["edot"]) < 0.2
        if row["method"] in ("seds", "p-qlf"):
            assert float(row["grid"]) == 1.0
            assert row["certified"] == "True"
            assert float(row["margin"]) > 0
            assert float(row["dtwd"]) < 1500
            assert float(row["swept_area"]) < 1500
        else:
            assert row["certified"] == "False"


def test_the_page_has_our_numbers_the_published_ones_and_every_definition(folder):
    page = (folder / "benchmark_lasa.md").read_text()
    for words in ("P-QLF (P learned)", "| SEDS | 6.34 ± 6.71 | 0.099 ± 0.062 | 3954 ± 7411", "5.19 ± 1.70", "### SEDS"):
        assert words in page
    for measure in ("RMSE", "ė", "DTWD", "Swept area", "Grid at goal", "Certified", "Fit"):
        assert f"- {measure}: " in page
    mean = next(float(row["rmse"]) for row in rows(folder, "by_method") if row["method"] == "p-qlf")
    assert f"| P-QLF (P learned) | {mean:.2f} ±" in page
    picture = matplotlib.image.imread(folder / "fields.png")
    assert picture.shape[1] > 1500
    assert picture.std() > 0.05


def test_repetitions_draw_splits_from_their_seeds():
    published, drawn = (BenchmarkLasa(motions=("Worm",), split=split) for split in ("published", "random"))
    demos = [published.draw(r).test[0][0].x for r in (0, 1)]
    assert torch.equal(*demos)
    first, again, second = (drawn.draw(r) for r in (0, 0, 1))
    assert torch.equal(first.x, again.x)
    assert not torch.equal(first.x, second.x)
    assert len(first.train[0]) == 4
    assert first.x.shape == (1, 3, 500, 2)
    assert len(first.train[0][0].x) == 125


def test_the_share_at_the_goal_counts_each_motions_starts():
    """One field ends at the goal, one beside it, one only where x1 > 0 (half of the starts), one runs away."""
    slopes = torch.diag_embed(torch.tensor([[-1.0, -1.0], [-1.0, -1.0], [0.0, -1.0], [1.0, 1.0]])).double()
    offsets = torch.tensor([[0.0, 0.0], [5.0, 0.0], [0.0, 0.0], [0.0, 0.0]]).double()
    gate = torch.ones(4, 1).double(), torch.zeros(4, 1, 2).double(), torch.eye(2).double().expand(4, 1, 2, 2)
    policy = GMRPolicy(*gate, slopes.unsqueeze(1), offsets.unsqueeze(1))
    box = torch.tensor([[-5.0, -10.0], [5.0, 10.0]]).double().unsqueeze(1).expand(2, 4, 2).clone()
    box[0, 2, 0], box[1, 2, 0] = -0.5, 5.5  # x1 from -1.1 to 6.1 in 15 steps of 0.48: four within 1 mm of the goal's x1
    with torch.no_grad():
        share = share_at_goal(policy, box, torch.zeros(4, 2).double())
    assert share.tolist() == [1.0, 0.0, 4 / 16, 0.0]


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"repetitions": 0}, InvalidArgumentError, "at least one repetition and one motion are needed, got 0 and 26"),
        ({"motions": ()}, InvalidArgumentError, "got 10 and 0"),
        ({"motions": ("Wurm",)}, UnknownNameError, "unknown single LASA motion 'Wurm'. Did you mean 'Worm'"),
    ],
)
def test_wrong_options_are_refused_before_a_folder_is_made(options, kind, message, tmp_path):
    with pytest.raises(kind, match=message):
        BenchmarkLasa(logdir=tmp_path, **options).main()
    assert not list(tmp_path.iterdir())
