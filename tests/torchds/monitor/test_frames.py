import builtins

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import torchds
from torchds import files
from torchds.errors import FileError, MissingPackageError
from torchds.monitor import TensorBoard, to_dataframe


def write(folder):
    content = {"rollouts": [0, 5], "cost": [[1.5, 2.5], [0.5, None]], "terms": {"goal": [[1.0, 2.0], [0.5, None]]}}
    files.write_sealed(folder / "results.json", {**content, "seconds": 0.1})


def test_a_run_is_one_row_for_each_update_and_run(tmp_path):
    pytest.importorskip("pandas", exc_type=ImportError)
    write(tmp_path)
    frame = to_dataframe(tmp_path)
    assert list(frame) == ["update", "run", "rollouts", "cost", "cost/goal"] and len(frame) == 4
    assert frame.loc[1].tolist() == [0, 1, 0, 2.5, 2.0]
    assert frame["cost"].isna().tolist() == [False, False, False, True]
    assert frame.groupby("rollouts")["cost"].median().tolist() == [2.0, 0.5]


def test_what_tensorboard_wrote_is_a_row_for_each_step(tmp_path):
    pytest.importorskip("pandas", exc_type=ImportError)
    theta = torch.nn.Parameter(torch.zeros(2))
    optim = torchds.optim.PIBB([theta], torchds.exploration.Gaussian(0.3), n_rollouts=4)
    board, seen = TensorBoard(tmp_path), []
    for update in range(1, 4):
        optim.step(lambda: theta.square().sum(-1))
        board(optim, theta, update)
        seen.append(optim.scalars()["exploration/mean_cost"])
    frame = to_dataframe(tmp_path)
    assert frame.index.tolist() == [4, 8, 12] and frame.index.name == "rollouts"
    assert frame["exploration/mean_cost"].tolist() == pytest.approx(seen, rel=1e-6)
    read = EventAccumulator(str(tmp_path)).Reload()
    assert set(frame) == set(read.Tags()["scalars"])
    (path,) = tmp_path.glob("events.*")
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert to_dataframe(tmp_path).index.tolist() == [4, 8, 12]  # the last record alone is not there yet
    for place in (2, 9, 20, len(whole) // 2, len(whole) - 2):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        with pytest.raises(FileError, match="is damaged"):
            to_dataframe(tmp_path)


def test_a_folder_without_a_run_is_refused(tmp_path):
    pytest.importorskip("pandas", exc_type=ImportError)
    with pytest.raises(FileError, match=r"has no results\.json and no events; give the folder of a finished run"):
        to_dataframe(tmp_path)


def test_results_that_were_changed_are_refused(tmp_path):
    pytest.importorskip("pandas", exc_type=ImportError)
    write(tmp_path)
    path = tmp_path / "results.json"
    path.write_text(path.read_text().replace("0.1", "0.2"))
    with pytest.raises(FileError, match="damaged"):
        to_dataframe(tmp_path)


def test_without_pandas_the_extra_is_named(tmp_path, monkeypatch):
    real = builtins.__import__

    def hidden(name, *rest, **kind):
        if name == "pandas":
            raise ImportError(name)
        return real(name, *rest, **kind)

    monkeypatch.setattr(builtins, "__import__", hidden)
    with pytest.raises(MissingPackageError, match=r"a data frame needs the package 'pandas'.*torchds\[monitor\]"):
        to_dataframe(tmp_path)
