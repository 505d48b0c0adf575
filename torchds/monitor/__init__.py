"""What a search says about itself: in TensorBoard, to any function, and as a data frame.

A callback is called as `callback(optim, policy, update)` after each update; its steps are roll-outs, so that searches that try
more in an update stand beside others fairly. The training commands write through the same functions.

Stability: stable.
"""

from torchds.monitor.callbacks import Callback as Callback
from torchds.monitor.callbacks import TensorBoard as TensorBoard
from torchds.monitor.frames import to_dataframe as to_dataframe
from torchds.monitor.scalars import of_costs as of_costs
from torchds.monitor.scalars import of_search as of_search

__all__ = ["Callback", "TensorBoard", "of_costs", "of_search", "to_dataframe"]
