import os
import sys

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import torchds
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError
from torchds.monitor import Callback, TensorBoard

WALK = torch.linspace(0, 1, 6, dtype=torch.float64)[:, None]


def problem(batch=()):
    """A point to find, and a search for it."""
    theta = torch.nn.Parameter(torch.zeros(*batch, 2, dtype=torch.float64))
    generator = torch.Generator().manual_seed(0)
    return theta, torchds.optim.PIBB([theta], torchds.exploration.Gaussian(0.3), n_rollouts=8, generator=generator)


def cost(theta):
    return (theta - 1).square().sum(-1)


def run(callback, updates, begin=1, at=None):
    theta, optim = at or problem()
    for update in range(begin, begin + updates):
        optim.step(lambda: cost(theta))
        callback(optim, theta, update)
    return theta, optim


def read(folder):
    return EventAccumulator(str(folder), size_guidance={"scalars": 0, "images": 0}).Reload()


def steps(folder, tag="cost/tried"):
    return [event.step for event in read(folder).Scalars(tag)]


def test_a_function_gets_the_scalars_and_the_rollouts_spent():
    seen = {}
    theta, _ = run(Callback(lambda scalars, step: seen.update({step: scalars}), cost), 3)
    assert list(seen) == [8, 16, 24] and [s["rollouts/updates"] for s in seen.values()] == [1, 2, 3]
    assert seen[24]["cost/total"] == pytest.approx(float(cost(theta.detach())), rel=1e-15)
    assert seen[24]["cost/total"] < seen[8]["cost/total"] and seen[8].keys() >= {"cost/tried", "exploration/lr"}


def test_named_terms_of_a_batch_become_medians():
    seen = []
    theta, optim = problem(batch=(5,))
    theta.data[:, 0] = torch.arange(5.0)
    terms = lambda theta: {"x": theta[:, 0], "y": theta[:, 1]}  # noqa: E731
    Callback(lambda scalars, step: seen.append(scalars), terms)(optim, theta, 0)
    assert [seen[0][f"cost/{tag}"] for tag in ("total", "total_q1", "total_q3", "x", "y")] == [2, 1, 3, 2, 0]


def test_the_gradient_baseline_is_reported_too():
    seen = []
    theta = torch.nn.Parameter(torch.zeros(2))
    Callback(lambda scalars, step: seen.append((step, scalars)), cost)(torch.optim.Adam([theta], lr=0.1), theta, 4)
    ((step, scalars),) = seen
    assert step == 4 and scalars["exploration/lr"] == 0.1 and scalars["cost/total"] == 2.0


def test_a_count_of_updates_below_zero_is_refused():
    with pytest.raises(InvalidArgumentError, match="number of updates made so far, at least 0, got -1"):
        Callback(print)(problem()[1], None, -1)


def test_tensorboard_has_scalars_over_rollouts_after_each_call(tmp_path):
    board = TensorBoard(tmp_path / "run", cost, options={"spread": 0.3})
    at = run(board, 2)
    assert steps(tmp_path / "run") == [8, 16]
    run(board, 1, begin=3, at=at)
    assert steps(tmp_path / "run", "cost/total") == [8, 16, 24]
    assert {"_hparams_/session_start_info", "custom_scalars__config__"} <= set(read(tmp_path / "run").summary_metadata)


def test_a_run_goes_on_from_a_checkpoint_with_every_update_once(tmp_path):
    board = TensorBoard(tmp_path)
    at = run(board, 2)
    torch.save(board.state_dict(), tmp_path / "state.pt")
    run(board, 3, begin=3, at=at)  # lost, since no checkpoint was made after it
    again = TensorBoard(tmp_path)
    again.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    run(again, 1, begin=3, at=at)
    assert steps(tmp_path) == [8, 16, 24]


@pytest.mark.parametrize("left", [0, 40, None])
def test_where_the_file_of_a_checkpoint_is_cut_or_lost_this_is_said_and_a_whole_one_begins(tmp_path, left):
    board = TensorBoard(tmp_path)
    at = run(board, 2)
    state, path = board.state_dict(), tmp_path / "events.out.tfevents.run"
    path.unlink() if left is None else os.truncate(path, left)
    again = TensorBoard(tmp_path, options={"spread": 0.3})
    with pytest.warns(UserWarning, match="was cut or lost; it has the updates from here on alone"):
        again.load_state_dict(state)
    run(again, 1, begin=3, at=at)
    assert steps(tmp_path) == [24]
    assert {"_hparams_/session_start_info", "custom_scalars__config__"} <= set(read(tmp_path).summary_metadata)


def test_a_folder_of_another_run_is_left_alone(tmp_path):
    run(TensorBoard(tmp_path), 1)
    with pytest.raises(FileError, match="is there already; give each run a folder of its own, or continue that one"):
        run(TensorBoard(tmp_path), 1)
    assert steps(tmp_path) == [8]


@pytest.mark.slow
def test_motions_are_drawn_at_the_beginning_and_every_few_updates(tmp_path):
    run(TensorBoard(tmp_path, motion=lambda theta: WALK * theta, every=3), 7)
    assert [picture.step for picture in read(tmp_path).Images("motion")] == [8, 24, 48]


def test_pictures_every_zero_updates_are_refused(tmp_path):
    with pytest.raises(InvalidArgumentError, match="every has to be a number of updates, at least 1, got 0"):
        TensorBoard(tmp_path, every=0)


def test_without_tensorboard_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "torchds.monitor.events", raising=False)
    monkeypatch.delattr(torchds.monitor, "events", raising=False)
    monkeypatch.setitem(sys.modules, "tensorboard.compat.proto.event_pb2", None)
    with pytest.raises(MissingPackageError, match=r"'tensorboard'.*pip install 'torchds\[monitor\]'"):
        TensorBoard(tmp_path)
