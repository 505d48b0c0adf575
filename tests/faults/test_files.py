"""Every kind of file that the commands write, damaged at many places: refused by name, or what it holds is what was written."""

import numpy as np
import pytest
import torch

from tests.faults import cases
from torchds import GaussianMixture, GMRPolicy, archives, files
from torchds.errors import FileError, TorchdsError
from torchds.sessions import given
from train.folder import RunFolder
from train.learning.history import History, results
from train.options import options_for
from train.paper.claims import command as claims
from train.paper.claims.base import Check
from train.paper.measured.digging import Experiment

PLACES = min(200, cases.CASES) or 20
OPTIONS = options_for("via_point", runs=2, updates=3)
HISTORY = History([0, 5], [[1.5, 2.5], [0.5, float("nan")]], {"goal": [[1.5, 2.5], [0.5, 0.1]]}, [0, 1], [0, 5], 3.25)
TENSORS = {"A": torch.arange(24, dtype=torch.float64).reshape(2, 3, 4), "b": torch.ones(3)}
POLICY = GMRPolicy(
    torch.tensor([0.5, 0.5]), torch.ones(2, 2), torch.eye(2).repeat(2, 1, 1), -torch.ones(2, 2, 2), torch.ones(2, 2)
)


class Learned:
    """A learner that keeps whatever it is given."""

    def __init__(self):
        self.options, self.history, self.state = OPTIONS, HISTORY, {"policy": TENSORS, "n": 3, "lr": 0.1}

    def state_dict(self):
        return self.state

    def load_state_dict(self, state):
        self.state = state


MIXTURE = GaussianMixture(torch.ones(1), torch.arange(4.0)[None], torch.eye(4)[None])


def numbers(mixture):
    return {"priors": mixture.priors, "means": mixture.means, "covariances": mixture.covariances}


def restored(folder):
    learner = Learned()
    events = RunFolder(folder).restore(learner)
    return [events, learner.state]


def policy(folder):
    learned = RunFolder(folder).policy()
    return [learned.state_dict(), learned.info.units]


def without_torch(folder):
    content = archives.read(folder / "controller.pt", "policy")
    return [{name: torch.from_numpy(value.copy()) for name, value in content["values"].items()}, content["units"]]


def experiment(folder):
    return Experiment(folder, 0, options_for("lwr_digging", seed=3))


def write_trials(folder):
    said = {"task": "lwr_digging", "options": experiment(folder).options.to_json(), "versions": {}}
    files.write_sealed(folder / "trials.json", {**said, "trials": {"uniform-75": {"total": [1.0, 0.5]}}})


KINDS = {
    "options.json": (
        lambda folder: RunFolder(folder).begin(OPTIONS.task, OPTIONS.to_json()),
        lambda folder: RunFolder(folder).options().to_json(),
    ),
    "checkpoint.pt": (lambda folder: RunFolder(folder).save_checkpoint(Learned(), 99), restored),
    "results.json": (
        lambda folder: RunFolder(folder).write_results(results("via_point", OPTIONS.to_json(), HISTORY)),
        lambda folder: RunFolder(folder).results(),
    ),
    "policy.pt": (lambda folder: POLICY.save(folder / "policy.pt", units="m"), policy),
    "controller.pt": (lambda folder: POLICY.save(folder / "controller.pt", units="m"), without_torch),
    "session.pt": (
        lambda folder: files.save(folder / "session.pt", "session", {"learner": TENSORS, "asked": True}),
        lambda folder: files.load(folder / "session.pt", "session"),
    ),
    "asked.json": (
        lambda folder: given.give(folder, "0123abcd", {"rollout-1.csv": "time [s]\n0\n"}),
        lambda folder: given.check_given(folder, "0123abcd") or [],
    ),
    "trials.json": (write_trials, lambda folder: experiment(folder).recorded()),
    "gravel.pt": (
        lambda folder: files.save(folder / "gravel.pt", "bed of gravel", {"key": "k", "places": TENSORS["A"]}),
        lambda folder: files.load(folder / "gravel.pt", "bed of gravel"),
    ),
    "mixture.npz": (
        lambda folder: MIXTURE.save(folder / "mixture.npz"),
        lambda folder: numbers(GaussianMixture.load(folder / "mixture.npz")),
    ),
    "demonstrations.npz": (
        lambda folder: files.write_npz(folder / "demonstrations.npz", {"x": np.arange(50.0), "dt": np.array(0.1)}),
        lambda folder: {
            k: torch.from_numpy(np.array(v)) for k, v in files.read_npz(folder / "demonstrations.npz").items()
        },
    ),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("damage", ["flip", "cut", "foreign", "exchange"])
@pytest.mark.slow
def test_damage_is_named_or_changes_nothing(name, damage, tmp_path, capsys):
    write, read = KINDS[name]
    write(tmp_path)
    path, expected = tmp_path / name, files.digest(read(tmp_path))
    raw = path.read_bytes()
    rng = np.random.default_rng(None if cases.CASES else [len(raw), len(damage)])
    for _ in range(PLACES):
        damaged, at = bytearray(raw), int(rng.integers(len(raw)))
        if damage == "flip":
            damaged[at] ^= 1 << int(rng.integers(8))
        elif damage == "cut":
            damaged = damaged[:at]
        elif damage == "foreign":
            damaged = bytearray(rng.bytes(int(rng.integers(300))))
        else:  # a block of zeros, as a disk leaves them
            damaged[at : at + 512] = bytes(len(damaged[at : at + 512]))
        path.write_bytes(damaged)
        cases.TRIED["test_files"] += 1
        try:
            found = read(tmp_path)
        except TorchdsError as error:
            assert str(error).count("\n") == 0 and str(tmp_path) in str(error)
            continue
        assert files.digest(found) == expected
    assert not [other for other in tmp_path.iterdir() if other.name.endswith(".part")]
    capsys.readouterr()


def test_a_claim_whose_file_is_damaged_is_measured_again(tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "source", lambda: "the same")
    measured = []

    class Claim:
        id, simulated = "one", True

        @staticmethod
        def measure(setting):
            measured.append(1)
            return [Check("a", True, 3)]

    command = claims.Claims(runs=2)
    for _ in range(2):
        command.checks(Claim, None, tmp_path)
    assert len(measured) == 1
    path = tmp_path / "one.json"
    path.write_text(path.read_text().replace('"a"', '"b"'))
    command.checks(Claim, None, tmp_path)
    assert len(measured) == 2


def test_trials_of_other_options_are_refused_by_what_differs(tmp_path):
    write_trials(tmp_path)
    other = Experiment(tmp_path, 0, options_for("lwr_digging", seed=3, grains="coarse"))
    with pytest.raises(FileError, match=r"trials\.json belongs to another run: grains fine there and coarse here"):
        other.recorded()


def test_links_are_replaced_and_not_followed(tmp_path):
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "results.json").symlink_to(tmp_path / "precious")
    RunFolder(tmp_path).write_results(results("via_point", {}, HISTORY))
    assert (tmp_path / "precious").read_text() == "mine" and not (tmp_path / "results.json").is_symlink()
