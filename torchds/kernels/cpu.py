"""Roll-outs on the CPU: one scalar loop over time for each roll-out, compiled by numba.

Arithmetic is in strict order and without shortcuts, so that a roll-out's numbers are the same bits in whatever company, and
infinity and NaN come out as they do from tensors. Arrays are flat: roll-out i belongs to policy i // S where a policy has S
points, and b policies over G gatings use gating b % G. `axes` and `experts` have D and K entries (`compiling.run`).

Stability: experimental.
"""

from __future__ import annotations

import functools
import math
import types
from typing import Any

import numpy as np

from torchds.kernels import steps
from torchds.kernels.compiling import compiled, jitted, piece
from torchds.kernels.gating import activate, expert

NONE, BOUNDS, WALLS = steps.NONE, steps.BOUNDS, steps.WALLS
CONSTANT, BEYOND, AWAY, AWAY_ALONG_NORMAL = steps.CONSTANT, steps.BEYOND, steps.AWAY, steps.AWAY_ALONG_NORMAL


# ---------------------------------------------------------------------- stop conditions, forces, plants


@piece
def stop_step(kind, p, x, x_next):
    """Whether the step from `x` to `x_next` must not be taken."""
    D = len(x)
    if kind == BOUNDS:  # low, high of each axis
        for d in range(D):
            if not (p[d] <= x_next[d] <= p[D + d]):
                return True
    elif kind == WALLS:  # two ends of each wall
        for w in range(0, len(p), 4):
            p0, p1, q0, q1 = p[w], p[w + 1], p[w + 2], p[w + 3]
            a0, a1, b0, b1 = x[0], x[1], x_next[0], x_next[1]
            side_a = (q0 - p0) * (a1 - p1) - (q1 - p1) * (a0 - p0)
            side_b = (q0 - p0) * (b1 - p1) - (q1 - p1) * (b0 - p0)
            side_p = (b0 - a0) * (p1 - a1) - (b1 - a1) * (p0 - a0)
            side_q = (b0 - a0) * (q1 - a1) - (b1 - a1) * (q0 - a0)
            near0 = min(a0, b0) <= max(p0, q0) and max(a0, b0) >= min(p0, q0)
            near1 = min(a1, b1) <= max(p1, q1) and max(a1, b1) >= min(p1, q1)
            if side_a * side_b <= 0 and side_p * side_q <= 0 and near0 and near1:
                return True
    return False


@piece
def force_step(kind, p, t, x, v, force):
    """Write the external force at time `t`, position `x` and velocity `v`."""
    D = len(x)
    for d in range(D):
        force[d] = 0.0
    if kind == CONSTANT:  # the force
        for d in range(D):
            force[d] = p[d]
    elif kind == BEYOND:  # border, axis, the force beyond it
        if x[int(p[1])] > p[0]:
            for d in range(D):
                force[d] = p[2 + d]
    elif kind in (AWAY, AWAY_ALONG_NORMAL):  # gain, points of a path, their squares, their normals
        n = (len(p) - 1) // (2 * D + 1)
        nearest, least = 0, np.inf
        for i in range(n):
            distance = 0.0
            for d in range(D):
                distance += x[d] * p[1 + i * D + d]
            distance = p[1 + n * D + i] - 2.0 * distance
            if distance < least or distance != distance:
                nearest, least = i, distance
                if distance != distance:
                    break
        if kind == AWAY:
            for d in range(D):
                force[d] = p[0] * (x[d] - p[1 + nearest * D + d])
        else:
            normals = 1 + n * (D + 1) + nearest * D
            square, side = 0.0, 0.0
            for d in range(D):
                offset = x[d] - p[1 + nearest * D + d]
                square += offset * offset
                side += p[normals + d] * offset
            size = p[0] * math.sqrt(square) * np.sign(side)
            for d in range(D):
                force[d] = size * p[normals + d]


@piece
def plant_step(kind, p, before, after, external, x_before, x, v_before, v, stiffness, t, dt):
    """Write the state of a point mass under impedance control after one step, `ImpedanceControlled.step`.

    Parameters: mass, damping, explicit, low, high, max_rate, constant; then of each axis its stiffness, or the row it follows;
    then of each step the errors of position and velocity and a push, if there are any.
    """
    D = len(x)
    chance = 7 + D + 3 * D * round(t / dt)
    disturbed = chance < len(p)
    m, damping, low, high, max_rate = p[0], p[1], p[3], p[4], p[5]
    explicit, constant = p[2] != 0, p[6] != 0
    for d in range(D):
        s = p[7 + d]
        if not constant:
            s = stiffness[int(s)]
            if s < low:
                s = low
            if s > high:
                s = high
        if t > 0 and max_rate < np.inf:
            last, most = before[3 * D + d], max_rate * dt
            change = s - last
            if change > most:
                change = most
            elif change < -most:
                change = -most
            s = last + change
        brake = 2.0 * math.sqrt(s * m)
        position, speed = before[d], before[D + d]
        seen, seen_speed, force = position, speed, external[d]
        if disturbed:
            seen, seen_speed, force = (
                seen + p[chance + d],
                seen_speed + p[chance + D + d],
                force + p[chance + 2 * D + d],
            )
        if explicit:
            u = s * (x[d] - seen) + brake * (v[d] - seen_speed)
            a = (u + force - damping * speed) / m
        else:
            u = s * (x_before[d] - seen - dt * speed) + brake * (v_before[d] - seen_speed)
            a = (u + force - damping * speed) / (m + s * dt * dt + brake * dt)
        new = speed + a * dt
        after[d] = position + new * dt
        after[D + d] = new
        after[2 * D + d] = a
        after[3 * D + d] = s
        after[4 * D + d] = force


# ---------------------------------------------------------------------- roll-outs


def roll(
    first, last, axes, experts, n_points, dt, start, rows, center, factors, offset, log_scale, limit,
    x, v, gating, stiffness, shift, stop, plant,
):  # fmt: skip
    """Roll-outs `first` ≤ i < `last` of `torchds.rollout`.

    `stop` is (kind, parameters, resting) and `plant` (kind, parameters, force kind, its parameters, states), or None: what is
    compiled then does not contain them.
    """
    D, K, n_velocities, n_steps = len(axes), len(experts), v.shape[2], v.shape[1]
    seen, external, still = np.empty(D), np.zeros(D), np.zeros_like(v[0, 0])
    for i in range(first, last):
        policy, rests = i // n_points, False
        gate, R = policy % len(log_scale), rows[policy]
        c, W, off, scales, moved = center[gate], factors[gate], offset[gate], log_scale[gate], shift[i % len(shift)]
        for d in range(D):
            x[i, 0, d] = start[i % len(start), d]
        for t in range(n_steps):
            here, there, h, y, s = x[i, t], x[i, t + 1], gating[i, t], v[i, t], stiffness[i, t]
            for d in range(D):
                seen[d] = here[d] - moved[d]
            activate(axes, experts, seen, c, W, off, scales, limit, h)
            for o in range(len(R)):
                value = 0.0
                for k in range(K):
                    value += expert(axes, R[o], k, h[k], seen)
                if o < n_velocities:
                    y[o] = value
                else:
                    s[o - n_velocities] = value
            for d in range(D):
                there[d] = here[d] + dt * y[d]
            if stop is not None:
                kind, limits, resting = stop
                rests = rests or stop_step(kind, limits[i % len(limits)], here, there)
                resting[i, t] = rests
                if rests:
                    for d in range(D):
                        there[d] = here[d]
                    for o in range(n_velocities):
                        y[o] = 0.0
            if plant is not None:
                tracked, p, force_kind, q, states = plant
                before, after = states[i, t], states[i, t + 1]
                force_step(force_kind, q[i % len(q)], t * dt, before[:D], before[D : 2 * D], external)
                y_before = v[i, t - 1] if t > 0 else still
                plant_step(tracked, p[i % len(p)], before, after, external, here, there, y_before, y, s, t * dt, dt)


def extended(*own: Any) -> Any:
    """`roll` with a user's own stop condition, force and plant, where given, behind the names that it calls."""
    return _extended(*(None if function is None else jitted(function) for function in own))


@functools.lru_cache(maxsize=64)
def _extended(stop: Any, push: Any, track: Any) -> Any:
    own: dict[str, Any] = {}
    if stop is not None:
        own["stop_step"] = piece(lambda kind, p, x, x_next: stop(p, x, x_next))
    if push is not None:
        own["force_step"] = piece(lambda kind, p, t, x, v, force: push(p, t, x, v, force))
    if track is not None:

        @piece
        def plant_step(kind, p, before, after, external, x_before, x, v_before, v, stiffness, t, dt):
            track(p, before, after, x_before, x, v_before, v, stiffness, t, dt)

        own["plant_step"] = plant_step
    return compiled(types.FunctionType(roll.__code__, {**globals(), **own}))
