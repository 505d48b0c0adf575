"""A policy in the loop of a robot.

Stability: stable.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from torchds import archives
from torchds.control import plain
from torchds.control.plan import Plan, plan
from torchds.control.tick import Tick, ring
from torchds.errors import InvalidArgumentError


class Controller:
    r"""One policy, tick by tick: x_{t+1} = x_t + ẋ_t dt with ẋ_t = policy(x_t − shift), as `torchds.rollout` has it.

    Everything is made before the loop: a tick allocates no array, and neither needs nor imports torch. In open loop x_t is
    the controller's own last position, a motion that an impedance or position controller tracks (Eq. 4). With `feedback` it is
    the measured one: the policy is a feedback law, and a push changes where the motion goes on.

    Args:
        policy: a `GMRPolicy` without a batch; `load` takes a file.
        dt: time step, one over the rate of the loop [s].
        feedback: whether the policy sees the measured position.
        compiled: whether a tick is one compiled function, which needs numba (extra `fast`) and a second or two here.
        max_speed: of the D positions, by their norm [unit/s].
        max_acceleration: of the D positions, by their norm [unit/s²]; also at the start, which is from rest.
        workspace: (low, high), numbers or `(D,)` each, which the position does not leave; it goes before `max_acceleration`.
        braking: time in which `pause` and `stop` come to rest [s], on the path of the motion.
        history: ticks that stay as they are before they are used again.
        clock: the time [s], for ticks that come late.

    Attributes:
        shift: `(D,)` how far the field is moved; may be written to between ticks, or see `retarget`.
        goal: `(D,)` where the motion ends without a shift; None if nothing was said about it.
        late: ticks since `reset` that came later than half a time step.

    Raises:
        InvalidArgumentError: a batch of policies, or an argument out of its range.
        MissingPackageError: `compiled` without numba.

    Example:
        >>> import torch, torchds
        >>> eye = torch.eye(2)[None]
        >>> policy = torchds.GMRPolicy(torch.ones(1), torch.zeros(1, 2), eye, -eye, torch.zeros(1, 2))
        >>> controller = torchds.Controller(policy, dt=0.5, max_speed=1.0)
        >>> controller.reset([2.0, 0.0])
        >>> controller.step()
        Tick(x=[1.5 0. ], v=[-1.  0.], stiffness=[], cut=('speed',), late=0.0)
        >>> controller.retarget([1.0, 0.0], goal=[0.0, 0.0])
        >>> controller.step().x
        array([1.25, 0.  ])
    """

    def __init__(
        self,
        policy: Any,
        dt: float,
        feedback: bool = False,
        *,
        compiled: bool = False,
        max_speed: float = math.inf,
        max_acceleration: float = math.inf,
        workspace: tuple[ArrayLike, ArrayLike] | None = None,
        braking: float = 0.2,
        history: int = 1000,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        given = {"dt": dt, "max_speed": max_speed, "max_acceleration": max_acceleration, "braking": braking}
        for name, value in given.items():
            if not value > 0 or (name in ("dt", "braking") and value == math.inf):
                raise InvalidArgumentError(f"{name} has to be positive, got {value!r}")
        if history < 2:
            raise InvalidArgumentError(f"history has to be at least 2 ticks, got {history}")
        values, goal = policy if isinstance(policy, tuple) else (arrays_of(policy), policy.info.goal)
        self.plan, self.dt, self.feedback, self.clock = plan(values, dt), float(dt), feedback, clock
        _, D, O, Q = self.plan.sizes
        self.shift = self.plan.shift
        self.goal = None if goal is None else _vector("goal", goal, D)
        self.plan.limits[1:3] = max_speed, max_acceleration * dt
        if workspace is not None:
            low, high = (_vector("workspace", edge, D, single=True) for edge in workspace)
            if not (low < high).all():
                raise InvalidArgumentError(f"workspace has to be (low, high) with low < high, got {low} and {high}")
            self.plan.low[:], self.plan.high[:] = low, high
        self._slower = dt / braking  # of the share of the speed, in a tick
        self._step = _compiled(self.plan) if compiled else plain.step(self.plan)
        self._ticks = ring(history, D, O, Q)
        self._measured = np.zeros(D)
        self._last: Tick | None = None
        self._next, self._wanted, self._stopped, self._due, self.late = 0, 1.0, False, math.inf, 0

    @classmethod
    def load(cls, path: str | Path, dt: float | None = None, feedback: bool = False, **options: Any) -> Self:
        """The controller of a policy that `policy.save` wrote; torch is not needed.

        Args:
            path: of the file.
            dt: time step [s]; that of the file if None.
            feedback: see `Controller`.
            **options: see `Controller`.

        Raises:
            FileError: see `torchds.archives.read`.
            InvalidArgumentError: no time step in the file and none given; see `Controller` too.
        """
        content = archives.read(path, "policy")
        dt = content["dt"] if dt is None else dt
        if dt is None:
            raise InvalidArgumentError(f"{path} does not say a time step; give dt=")
        return cls((content["values"], content["goal"]), dt, feedback, **options)

    # ------------------------------------------------------------------ the loop

    def reset(self, x0: ArrayLike) -> None:
        """Begin at rest at `x0` `(D,)`; the shift stays.

        Raises:
            InvalidArgumentError: not D finite numbers, or outside of the workspace.
        """
        x0 = _vector("x0", x0, len(self.shift))
        if not ((self.plan.low <= x0) & (x0 <= self.plan.high)).all():
            raise InvalidArgumentError(
                f"x0 has to be in the workspace, got {x0}, outside {self.plan.low} to {self.plan.high}"
            )
        self._last = self._ticks[-1]
        self._last._x[:], self._last._v[:] = x0, 0.0
        self.plan.limits[3] = self._wanted = 1.0
        self._next, self._stopped, self._due, self.late = 0, False, math.inf, 0

    def step(self, x: np.ndarray | None = None) -> Tick:
        """The next tick.

        Args:
            x: `(D,)` the measured position, where `feedback` is on.

        Raises:
            InvalidArgumentError: no `reset` before, a measurement that is missing or not finite, or a velocity that is not
                finite. The controller stays as it was before the call.
        """
        now, last, tick = self.clock(), self._last, self._ticks[self._next]
        late, self._due = now - self._due, now + self.dt
        if last is None:
            raise InvalidArgumentError("a controller has to know where it is before its first step; call reset(x0)")
        share, limits = self._wanted, self.plan.limits
        if limits[3] != share:
            limits[3] += min(max(share - limits[3], -self._slower), self._slower)
        tick.cut = self._step(self._seen(x) if self.feedback else last._x, last._v, tick._row)
        if tick.cut < 0:
            raise InvalidArgumentError(f"the velocity has to be finite, is not at x = {x if self.feedback else last.x}")
        tick.late = 0.0
        if late > 0.5 * self.dt:
            tick.late, self.late = late, self.late + 1
        self._last, self._next = tick, (self._next + 1) % len(self._ticks)
        return tick

    def _seen(self, x: np.ndarray | None) -> np.ndarray:
        """A measured position, checked."""
        try:
            self._measured[:] = x if len(x) == len(self._measured) else math.nan  # type: ignore[arg-type]
        except (TypeError, ValueError):
            self._measured[:] = math.nan
        if not math.isfinite(sum(self._measured.tolist())):
            raise InvalidArgumentError(
                f"with feedback, step(x) needs the measured position of {len(self._measured)} finite numbers, got {x!r}"
            )
        return self._measured

    # ------------------------------------------------------------------ while it runs

    def pause(self) -> None:
        """Come to rest on the path within the time `braking`, and stay there until `resume`."""
        self._wanted = 0.0

    def resume(self) -> None:
        """Go on after a pause, within the time `braking` as fast as before.

        Raises:
            InvalidArgumentError: it was stopped.
        """
        if self._stopped:
            raise InvalidArgumentError("a controller that was stopped has to begin anew; call reset(x0)")
        self._wanted = 1.0

    def stop(self) -> None:
        """Come to rest on the path within the time `braking`, and stay there until `reset`."""
        self._wanted, self._stopped = 0.0, True

    @property
    def resting(self) -> bool:
        """Whether a pause or a stop has come to rest."""
        return self._last is not None and self._wanted == 0.0 and not self._last._v.any()

    def retarget(self, target: ArrayLike, *, goal: ArrayLike | None = None) -> None:
        """Move the field so that the motion ends at `target`, from the next tick on (section 5.1).

        Args:
            target: `(D,)`.
            goal: `(D,)` where it ends without a shift; that of the policy's file by default.

        Raises:
            InvalidArgumentError: no goal is known, or not D finite numbers.
        """
        D = len(self.shift)
        self.goal = self.goal if goal is None else _vector("goal", goal, D)
        if self.goal is None:
            raise InvalidArgumentError("where the motion ends is not known; give goal=, or save the policy with goal=")
        self.shift[:] = _vector("target", target, D) - self.goal


def arrays_of(policy: Any) -> dict[str, np.ndarray]:
    """The arrays of a `GMRPolicy` by name, in float64.

    Raises:
        InvalidArgumentError: it is none.
    """
    try:
        named = {**dict(policy.named_buffers(recurse=False)), **policy.row_parameters}
    except AttributeError:
        raise InvalidArgumentError(
            f"policy has to be a GMRPolicy, got {type(policy).__name__}; load() takes a file"
        ) from None
    return {name: value.detach().cpu().double().numpy() for name, value in named.items()}


def _vector(name: str, value: ArrayLike, D: int, *, single: bool = False) -> np.ndarray:
    """`(D,)` finite numbers; with `single`, one number for all may be given, and infinity."""
    try:
        array = np.asarray(value.detach().cpu() if hasattr(value, "detach") else value)
    except (TypeError, ValueError):
        array = np.empty(0)
    fits = array.shape == (D,) or (single and array.shape == ())
    if (
        not fits
        or array.dtype.kind not in "biuf"
        or not (np.isfinite(array).all() or (single and not np.isnan(array).any()))
    ):
        raise InvalidArgumentError(f"{name} has to be {D} finite numbers, got {' '.join(repr(value).split()):.80}")
    return np.broadcast_to(array, (D,)).astype(np.float64)


def _compiled(plan: Plan) -> plain.Step:
    from torchds.control import compiled

    return compiled.step(plan)
