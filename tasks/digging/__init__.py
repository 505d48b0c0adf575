"""The digging task of section 6: a KUKA LWR 4+ shovels gravel in MuJoCo, under Cartesian impedance control."""

import ctypes.util
import importlib.util
import os
import sys

from torchds.errors import MissingPackageError

for _package, _module in (("mujoco", "mujoco"), ("pytorch-kinematics", "pytorch_kinematics")):
    if importlib.util.find_spec(_module) is None:
        raise MissingPackageError(_package, "digging", "the digging task")

if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
    # Pictures without a screen, by what there is; MuJoCo reads this when it is imported, which fails if OpenGL is not whole.
    _opengl = ctypes.util.find_library("OpenGL") or ctypes.util.find_library("GL")
    for _library, _platform in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if _opengl and ctypes.util.find_library(_library):
            os.environ.setdefault("MUJOCO_GL", _platform)
            break

try:
    import mujoco
except ImportError:
    raise
except Exception:  # whatever an OpenGL library that is not whole raises: only pictures need it
    for _name in [name for name in sys.modules if name.partition(".")[0] == "mujoco"]:
        del sys.modules[_name]
    os.environ["MUJOCO_GL"] = "disabled"
    import mujoco  # noqa: F401
