"""A device that is not there: tensors that say they are on it, compute on the CPU, and refuse to meet tensors of the CPU.

What runs inside `pretended()` with everything at `FAR` keeps all its tensors together, so that it runs on a GPU too. Numbers
are those of the CPU. Numbers of dimension zero may come from elsewhere, as torch allows it for GPUs.
"""

from contextlib import contextmanager

import torch
from torch.overrides import TorchFunctionMode
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

FAR = torch.device("meta")  # the one device of torch that every build knows and nothing here uses


class _Far(torch.Tensor):
    """Says that it is on the device; `near` has its numbers."""

    @staticmethod
    def __new__(cls, near):
        layout = {"strides": near.stride(), "storage_offset": near.storage_offset(), "dtype": near.dtype}
        return torch.Tensor._make_wrapper_subclass(cls, near.shape, **layout, device=FAR)

    def __init__(self, near):
        self.near = near

    def tolist(self):
        return self.near.tolist()

    def __deepcopy__(self, memo):
        there = _Far(self.near.clone()).requires_grad_(self.requires_grad)
        there._is_param = isinstance(self, torch.nn.Parameter)
        return there

    @property
    def is_meta(self):
        return False

    @property
    def data(self):
        return self.detach()

    @data.setter
    def data(self, value):
        torch.Tensor.data.__set__(self, value)
        self.near = value.near

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return _call(func, args, kwargs or {})


class _Numbers(TorchFunctionMode):
    """Numbers that become tensors do so on the CPU first; for this device, torch would leave them out."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if func in (torch.tensor, torch.as_tensor) and torch.device(kwargs.get("device") or "cpu") == FAR:
            return func(*args, **kwargs | {"device": "cpu"}).to(FAR)
        if func is torch.Tensor.new_tensor and isinstance(args[0], _Far):
            return torch.tensor(args[1], dtype=kwargs.get("dtype", args[0].dtype)).to(kwargs.get("device", FAR))
        if func is torch.Tensor.__getitem__ and isinstance(args[1], (list, tuple)):
            index = [torch.tensor(each) if isinstance(each, list) else each for each in args[1]]
            args = (args[0], torch.tensor(args[1]) if isinstance(args[1], list) else tuple(index))
        return func(*args, **kwargs)


class _Everything(TorchDispatchMode):
    """Makes new tensors on the device where that is asked for."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return _call(func, args, kwargs or {})


def _call(func, args, kwargs):
    name, device = func.overloadpacket.__name__, kwargs.get("device")
    values, tree = pytree.tree_flatten((args, kwargs))
    there = any(isinstance(value, _Far) for value in values)
    if there and name not in ("_to_copy", "copy_", "index", "index_put_"):  # these take both
        for value in values:
            if isinstance(value, torch.Tensor) and not isinstance(value, _Far) and value.ndim:
                raise RuntimeError(f"{func}: tensors on two devices, {tuple(value.shape)} is on the CPU")
    if device is not None:
        there = device == FAR
    elif name == "copy_":
        there = isinstance(args[0], _Far)
    near = [value.near if isinstance(value, _Far) else value for value in values]
    near = [torch.device("cpu") if isinstance(value, torch.device) else value for value in near]
    args_near, kwargs_near = pytree.tree_unflatten(near, tree)
    result = func(*args_near, **kwargs_near)
    if not there:
        return result
    if name.endswith("_") and not name.startswith("_"):  # in place
        return args[0]
    return pytree.tree_map(lambda value: _Far(value) if isinstance(value, torch.Tensor) else value, result)


@contextmanager
def pretended():
    """The device is there, inside; what is compiled, and reads memory, is not."""
    with _Everything(), _Numbers():
        yield FAR


def near(value):
    """The numbers of a tensor of the device."""
    return value.to("cpu")
