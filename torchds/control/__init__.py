"""A policy in a control loop, with numpy alone: no module of this room imports torch.

Stability: stable.
"""

from torchds.control.controller import Controller as Controller
from torchds.control.passive import PassiveLaw as PassiveLaw
from torchds.control.plan import Cut as Cut
from torchds.control.playback import Playback as Playback
from torchds.control.playback import Recorder as Recorder
from torchds.control.tick import Tick as Tick

__all__ = ["Controller", "Cut", "PassiveLaw", "Playback", "Recorder", "Tick"]
