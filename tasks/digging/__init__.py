"""The digging task of section 6: a KUKA LWR 4+ shovels gravel in MuJoCo, under Cartesian impedance control."""

import importlib.util

from torchds.errors import MissingPackageError

for _package, _module in (("mujoco", "mujoco"), ("pytorch-kinematics", "pytorch_kinematics")):
    if importlib.util.find_spec(_module) is None:
        raise MissingPackageError(_package, "digging", "the digging task")
