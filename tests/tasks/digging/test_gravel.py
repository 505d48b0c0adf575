"""The bed: grains in order, settled once, and settings that make none."""

import importlib.util
from dataclasses import replace

import pytest

from torchds.errors import InvalidArgumentError, MissingPackageError

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

import numpy as np

import tasks.digging
from tasks.digging import gravel
from tasks.digging.gravel import COARSE
from torchds.files import load


@pytest.mark.slow
def test_grains_are_numbered_by_their_place():
    x = gravel.bed(COARSE)[:, 0]
    assert np.corrcoef(x, np.arange(len(x)))[0, 1] > 0.99


def test_a_bed_is_settled_once(monkeypatch):
    bed = gravel.bed(COARSE)

    def settle(settings, packing):
        raise AssertionError("settled again")

    monkeypatch.setattr(gravel, "settle", settle)
    np.testing.assert_array_equal(gravel.bed(COARSE), bed)
    with pytest.raises(AssertionError, match="settled again"):
        gravel.bed(replace(COARSE, seed=1))
    with pytest.raises(AssertionError, match="settled again"):
        gravel.bed(COARSE, 1)
    assert [path.suffix for path in gravel.cache_folder().iterdir() if COARSE.key(0) in path.name] == [".pt"]


@pytest.mark.slow
def test_a_broken_or_forbidden_cache_costs_only_time(tmp_path, monkeypatch):
    bed = gravel.bed(COARSE)
    (file,) = (path for path in gravel.cache_folder().iterdir() if COARSE.key(0) in path.name)
    whole = file.read_bytes()
    moved = bytearray(whole)
    moved[whole.index(bed[3, 0].tobytes()) + 6] ^= 1  # one grain
    for damaged in (b"half a file", bytes(moved), whole[:-200]):
        file.write_bytes(damaged)
        np.testing.assert_array_equal(gravel.bed(COARSE), bed)
        np.testing.assert_array_equal(load(file, "bed of gravel")["places"].numpy(), bed)
    (tmp_path / "torchds").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    np.testing.assert_array_equal(gravel.bed(COARSE), bed)


def test_settings_without_a_bed_are_refused():
    with pytest.raises(InvalidArgumentError, match="a bed has to have grains"):
        gravel.Gravel(radius=(0.02, 0.01))
    with pytest.raises(InvalidArgumentError, match="have to be positive"):
        gravel.Gravel(density=0.0)
    with pytest.raises(InvalidArgumentError, match="friction and sleep not negative"):
        gravel.Gravel(sleep=-1.0)
    with pytest.raises(gravel.SettlingError, match="still moves"):
        gravel.settle(gravel.Gravel(n_grains=100, seconds=0.02))


@pytest.mark.parametrize("package", ["mujoco", "pytorch_kinematics"])
def test_a_missing_package_is_named_with_the_extra(package, monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else find_spec(name))
    with pytest.raises(MissingPackageError, match=r"torchds\[digging\]"):
        importlib.reload(tasks.digging)
