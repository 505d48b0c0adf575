"""Sessions with a robot through files: `ask` writes the motions to execute, `tell` reads what was measured and learns.

docs/hardware.md is the page. Nothing is simulated, and whatever executes a table of positions at its times can take part.

Stability: stable.
"""

from torchds.sessions.layout import Layout as Layout
from torchds.sessions.session import Session as Session
from torchds.sessions.trial import Measured as Measured
from torchds.sessions.trial import Trial as Trial

__all__ = ["Layout", "Measured", "Session", "Trial"]
