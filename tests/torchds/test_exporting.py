"""What is written is read back by the program that it is for, and computes the same."""

import shutil
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchds
from torchds.errors import InvalidArgumentError, MissingPackageError, UnknownNameError

STEPS, DT = 30, 0.2
FAST = {
    "cpp_cache_precompile_headers": False,
    "aot_inductor.compile_wrapper_opt_level": "O0",
    "cpp.vec_isa_ok": True,
    "cpp.simdlen": 1,
}  # to compile


def read(path, format):
    """The file as a function of tensors, by other programs than torchds."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if format == "torch":
            return torch.export.load(path).module()
        if format == "aoti":
            return torch._inductor.aoti_load_package(str(path))
    session = pytest.importorskip("onnxruntime").InferenceSession(str(path))
    (given,) = session.get_inputs()
    return lambda x: [torch.from_numpy(y) for y in session.run(None, {given.name: x.numpy()})]


@pytest.fixture
def written(random_policy, randn, tmp_path):
    def write(format, motion, Q=0, n=5):
        if format == "onnx":
            pytest.importorskip("onnxscript")
        if format == "aoti" and shutil.which("g++") is None:
            pytest.skip("needs a C++ compiler")
        policy, x = random_policy(Q=Q, moved=True), 0.3 * randn(n, 2)
        path = tmp_path / f"policy.{format}"
        with torch._inductor.config.patch(FAST):
            torchds.export(policy, path, *((STEPS, DT) if motion else ()), format=format)
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            got = read(path, format)(x)
            if not motion:
                return got, [policy(x), *([policy.stiffness(x)] if Q else [])]
            path = torchds.rollout(policy, x, STEPS, DT, backend="eager")
            return got, [path.x, path.v, *([path.stiffness] if Q else [])]

    return write


@pytest.mark.slow
@pytest.mark.parametrize("format", ["torch", "onnx"])
def test_a_field_is_read_back(written, format):
    got, expected = written(format, motion=False, Q=2)
    assert len(got) == 2
    for ours, theirs in zip(got, expected, strict=True):
        assert_close(ours, theirs, rtol=1e-11, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("format", "Q", "n"),
    [
        ("torch", 0, 5),
        pytest.param("onnx", 1, 5, marks=pytest.mark.no_cover),
        pytest.param("aoti", 0, 1, marks=pytest.mark.no_cover),
    ],
)
def test_a_motion_is_read_back(written, format, Q, n):
    """In float64 to the end: a time step of 0.2 has no 32 bits."""
    got, expected = written(format, motion=True, Q=Q, n=n)
    for ours, theirs in zip(got, expected, strict=True):
        assert_close(ours, theirs, rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_what_cannot_be_exported_is_refused(random_policy, tmp_path, monkeypatch):
    policy, path = random_policy(), tmp_path / "policy"
    with pytest.raises(UnknownNameError, match=r"unknown format 'onx'. Did you mean 'onnx'"):
        torchds.export(policy, path, format="onx")
    with pytest.raises(
        InvalidArgumentError, match=r"one policy, got a batch \(3,\); export them one by one, policy\[i\]"
    ):
        torchds.export(random_policy(batch=(3,)), path)
    with pytest.raises(InvalidArgumentError, match=r"n_steps and dt have to be given together.*; got 10 and None"):
        torchds.export(policy, path, 10)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"an ONNX file needs the package 'onnx'.*torchds\[export\]"):
        torchds.export(policy, path)
    assert not list(tmp_path.iterdir())
