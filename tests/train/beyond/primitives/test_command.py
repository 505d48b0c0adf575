"""The command: a small run leaves tables, costs and the figure."""

import json

import pytest

from torchds.errors import InvalidArgumentError
from train.beyond.primitives.command import SYSTEMS, WAYS, Primitives


@pytest.mark.slow
def test_it_leaves_tables_costs_and_the_figure(tmp_path, capsys):
    folder = Primitives(runs=2, updates=1, logdir=tmp_path).main()
    rows = json.loads((folder / "costs.json").read_text())["rows"]
    assert [(row["shape"], row["system"], row["way"]) for row in rows] == [
        (shape, system, way) for shape in "NP" for system in SYSTEMS for way in WAYS
    ]
    assert [len(row["cost"][-1]) for row in rows] == [1 if row["way"] == "adam" else 2 for row in rows]
    initial = {(row["shape"], row["system"]): row["cost"][0][0] for row in rows}
    assert initial["N", "gmr"] == pytest.approx(3.12, abs=0.01)  # of the README
    report = (folder / "report.md").read_text()
    assert report.count("| N |") == 8 + 10 and "held for 8 s" in report and report in capsys.readouterr().out
    assert (folder / "primitives.png").stat().st_size > 50_000


@pytest.mark.parametrize("options", [{"runs": 1}, {"distance": 0.0}, {"seconds": 20.0}, {"updates": -1}])
def test_what_cannot_be_run_is_refused(options, tmp_path):
    with pytest.raises(
        InvalidArgumentError, match=r"--runs of at least 2, a positive --distance|--updates has to be at"
    ):
        Primitives(**options, logdir=tmp_path).main()
    assert not list(tmp_path.iterdir())
