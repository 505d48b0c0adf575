"""The adjoint of a roll-out, its Jacobians and its control cost on the CPU, compiled by numba; see `torchds.kernels.cpu`.

Stability: experimental.
"""

from __future__ import annotations

import numpy as np

from torchds.kernels.compiling import piece
from torchds.kernels.gating import activate, expert, whitened


def adjoint(
    first, last, axes, experts, n_points, dt, rows, center, factors, offset, log_scale, limit,
    inputs, gating, resting, on_x, on_v, on_gating, on_stiffness, on_rows, on_start,
):  # fmt: skip
    """The gradients with respect to rows and starts, from those with respect to all that a roll-out writes.

    With λ_t the gradient that reaches x_t, from the end to the start,

        λ_t = ∂/∂x_t + λ_{t+1} + (∂[ẋ; s]/∂x)ᵀ y + (∂h/∂x)ᵀ ∂/∂h,   y = [∂/∂v + dt λ_{t+1}; ∂/∂s],   ∂/∂R += y gᵀ,

    and with g = h_k [x, 1] and q_k = (∂/∂h)_k + Σ_o y_o (R_k [x, 1])_o the last two terms of it are

        Σ_k h_k (A_kᵀ y + (q_k − Σ_j h_j q_j) σ_k),   σ_k = −Σ_k⁻¹ (x − μ_k).
    """
    D, K, N, n_velocities, n_steps = len(axes), len(experts), rows.shape[1], on_v.shape[2], on_v.shape[1]
    q, y, back = np.empty(K), np.empty(N), np.empty(D)
    for i in range(first, last):
        policy = i // n_points
        gate, R, on_R, along = policy % len(log_scale), rows[policy], on_rows[i], on_start[i]
        c, W, off = center[gate], factors[gate], offset[gate]
        on_R[:] = 0.0
        for d in range(D):
            along[d] = on_x[i, n_steps, d]
        for t in range(n_steps - 1, -1, -1):
            seen, h = inputs[i, t], gating[i, t]
            moves = resting.size == 0 or not resting[i, t]
            for o in range(N):
                if o >= n_velocities:
                    y[o] = on_stiffness[i, t, o - n_velocities]
                elif not moves:
                    y[o] = 0.0
                else:
                    y[o] = on_v[i, t, o] + (dt * along[o] if o < D else 0.0)
            mean = 0.0
            for k in range(K):
                q[k] = on_gating[i, t, k]
                for o in range(N):
                    q[k] += y[o] * expert(axes, R[o], k, 1.0, seen)
                    for d in range(D):
                        on_R[o, k * (D + 1) + d] += y[o] * (h[k] * seen[d])
                    on_R[o, k * (D + 1) + D] += y[o] * h[k]
                mean += h[k] * q[k]
            for d in range(D):
                back[d] = on_x[i, t, d] + along[d]
            for k in range(K):
                for o in range(N):
                    for d in range(D):
                        back[d] += h[k] * R[o, k * (D + 1) + d] * y[o]
                for j in range(D):
                    z = whitened(axes, k, j, seen, c, W, off, limit)
                    if abs(z) < limit:
                        for d in range(D):
                            if abs(seen[d] - c[d]) < limit:
                                back[d] -= h[k] * (q[k] - mean) * W[k, j, d] * z
            for d in range(D):
                along[d] = back[d]


@piece
def linearise(axes, experts, x, R, center, factors, offset, limit, h, slope):
    """Write ∂[ẋ; s]/∂x = Σ_k h_k (A_k + (y_k − Σ_j h_j y_j) σ_kᵀ) to `slope`, with y_k = A_k x + b_k (`GMRPolicy.jacobian`)."""
    D, K = len(axes), len(experts)
    for o in range(len(slope)):
        mean = 0.0
        for d in range(D):
            slope[o, d] = 0.0
        for k in range(K):
            for d in range(D):
                slope[o, d] += h[k] * R[o, k * (D + 1) + d]
            mean += expert(axes, R[o], k, h[k], x)
        for k in range(K):
            y = expert(axes, R[o], k, 1.0, x)
            for j in range(D):
                z = whitened(axes, k, j, x, center, factors, offset, limit)
                for d in range(D):
                    slope[o, d] -= h[k] * (y - mean) * factors[k, j, d] * z


def sensitivities(
    first, last, axes, experts, n_points, dt, rows, center, factors, offset, log_scale, limit, inputs, resting, motion,
):  # fmt: skip
    """The Jacobian of the reference (.., T, O, P): J_{t+1} = (I + dt ∂f/∂x) J_t + dt G, as `torchds.sensitivity` has it."""
    D, K, N, n_steps = len(axes), len(experts), rows.shape[1], inputs.shape[1]
    O, E = motion.shape[2], N * (D + 1)  # E parameters of a component: all slopes, then all offsets
    h, slope, J = np.empty(K), np.empty((N, D)), np.empty((D, K * E))
    for i in range(first, last):
        policy = i // n_points
        gate = policy % len(log_scale)
        c, W, off, scales = center[gate], factors[gate], offset[gate], log_scale[gate]
        J[:] = 0.0
        for t in range(n_steps):
            x = inputs[i, t]
            activate(axes, experts, x, c, W, off, scales, limit, h)
            linearise(axes, experts, x, rows[policy], c, W, off, limit, h, slope)
            moves = resting.size == 0 or not resting[i, t]
            for o in range(O):
                row = motion[i, t, o]
                for p in range(K * E):
                    row[p] = 0.0 if t == 0 else motion[i, t - 1, o, p]
                if moves:
                    for d in range(D):
                        a = dt * slope[o, d]
                        for p in range(K * E):
                            row[p] += a * J[d, p]
                    for k in range(K):
                        for d in range(D):
                            row[k * E + o * D + d] += dt * h[k] * x[d]
                        row[k * E + N * D + o] += dt * h[k]
            for d in range(D):
                for p in range(K * E):
                    J[d, p] = motion[i, t, d, p]


def stiffness_sensitivities(
    first, last, axes, experts, n_points, rows, center, factors, offset, log_scale, limit, inputs, motion, stiffness,
):  # fmt: skip
    """The Jacobian of the stiffness outputs (.., T, Q, P) from that of the reference, `torchds.stiffness_sensitivity`."""
    D, K, N, n_steps = len(axes), len(experts), rows.shape[1], inputs.shape[1]
    E, Q = N * (D + 1), stiffness.shape[2]
    h, slope = np.empty(K), np.empty((N, D))
    for i in range(first, last):
        policy = i // n_points
        gate = policy % len(log_scale)
        c, W, off, scales = center[gate], factors[gate], offset[gate], log_scale[gate]
        for t in range(n_steps):
            x = inputs[i, t]
            activate(axes, experts, x, c, W, off, scales, limit, h)
            linearise(axes, experts, x, rows[policy], c, W, off, limit, h, slope)
            for q in range(Q):
                row, o = stiffness[i, t, q], N - Q + q
                for p in range(K * E):
                    row[p] = 0.0
                if t > 0:
                    for d in range(D):
                        for p in range(K * E):
                            row[p] += slope[o, d] * motion[i, t - 1, d, p]
                for k in range(K):
                    for d in range(D):
                        row[k * E + o * D + d] += h[k] * x[d]
                    row[k * E + N * D + o] += h[k]


def control(first, last, axes, experts, deviation, noise, weight, gating, inputs, upsilon):
    """Υ_t of `torchds.costs.control_cost` for roll-outs `first` ≤ i < `last`, with features h_k [x, 1].

    Roll-out i has entry i % len of each argument.
    """
    D, K, O, n_steps = len(axes), len(experts), deviation.shape[1], gating.shape[1]
    F = K * (D + 1)
    squares, alike = np.empty(D), np.empty(O, np.bool_)
    drifts, pushes, inverse = np.empty((O, F)), np.empty((O, F)), np.empty((O, F))
    for i in range(first, last):
        constant = 0.0
        R, theta, epsilon = weight[i % len(weight)], deviation[i % len(deviation)], noise[i % len(noise)]
        h, x = gating[i % len(gating)], inputs[i % len(inputs)]
        for o in range(O):
            alike[o] = o > 0  # whether this row's gᵀR⁻¹g is that of the row before
            for f in range(F):
                r, a, free = R[o, f], theta[o, f], not R[o, f] > 0
                constant += r * (a * a)
                inverse[o, f] = 0.0 if free else 1.0 / r
                drifts[o, f] = 0.0 if free else a
                pushes[o, f] = 0.0 if free else epsilon[o, f]
                if o > 0 and inverse[o, f] != inverse[o - 1, f]:
                    alike[o] = False
        for t in range(n_steps):
            total, size = constant, 0.0
            for d in range(D):
                squares[d] = x[t, d] * x[t, d]
            for o in range(O):
                drift, push = 0.0, 0.0
                if not alike[o]:
                    size = 0.0
                for k in range(K):
                    drift += expert(axes, drifts[o], k, h[t, k], x[t])
                    push += expert(axes, pushes[o], k, h[t, k], x[t])
                    if not alike[o]:
                        size += expert(axes, inverse[o], k, h[t, k] * h[t, k], squares)
                if size > 0:
                    total += (2.0 * drift + push) * push / size
            upsilon[i, t] = total
