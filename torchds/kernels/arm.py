"""The law of `torchds.cartesian` for one arm after the other, compiled by numba.

With J̃ = J L⁻ᵀ, M = L Lᵀ, and C = √K J̃ = P Σ Qᵀ, the root of J̃ᵀ K J̃ is Q Σ Qᵀ, and the damping torque

    −2 ζ L Q (Σ Qᵀ Lᵀ q̇ − Pᵀ √K ẋ^ref)

The decomposition is a one-sided Jacobi rotation of six columns.

Stability: experimental.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from torchds.kernels.compiling import kept, piece

SWEEPS, ROUND_OFF = 40, 1e-15
SMALL = 1e-7  # share of the largest direction below which the tool cannot be moved in one


def law(*arguments: Any) -> None:
    """Call the compiled loop, whose arguments `_arms` has."""
    _call(_arms, arguments)


def in_space(*arguments: Any) -> None:
    """Call the compiled loop, whose arguments `_planes` has."""
    _call(_planes, arguments)


def _call(loop: Any, arguments: tuple[Any, ...]) -> None:
    made = _made.get(loop)
    if made is None:
        made = _made[loop] = kept(loop, ("float64",), arguments)
    made(*arguments)


_made: dict[Any, Any] = {}


def _planes(n, x, angle, v, rate, first, second, normal, sign, offset, position, rotation, twist):
    """References in a plane as references in space, `torchds.targets.Plane.pose`."""
    position[:], rotation[:], twist[:] = 0.0, 0.0, 0.0
    for i in range(n):
        c, s = math.cos(angle[i]), math.sin(angle[i])
        position[i, first], position[i, second], position[i, normal] = x[i, 0], x[i, 1], offset
        rotation[i, first, first], rotation[i, first, second] = c, -s
        rotation[i, second, first], rotation[i, second, second] = s, c
        rotation[i, normal, normal] = 1.0
        twist[i, first], twist[i, second], twist[i, 3 + normal] = v[i, 0], v[i, 1], sign * rate[i]


@piece
def _pose(q, axes, home, spatial, T):
    """The pose T of the tool, and the screws of the joints where they are now."""
    for i in range(3):
        for j in range(4):
            T[i, j] = 1.0 if i == j else 0.0
    W, E = np.empty((3, 3)), np.empty((3, 4))
    for k in range(len(q)):
        v, w = axes[:3, k], axes[3:, k]
        for i in range(3):
            spatial[3 + i, k] = T[i, 0] * w[0] + T[i, 1] * w[1] + T[i, 2] * w[2]
            spatial[i, k] = T[i, 0] * v[0] + T[i, 1] * v[1] + T[i, 2] * v[2]
        a, b, c = spatial[3, k], spatial[4, k], spatial[5, k]
        spatial[0, k] += T[1, 3] * c - T[2, 3] * b
        spatial[1, k] += T[2, 3] * a - T[0, 3] * c
        spatial[2, k] += T[0, 3] * b - T[1, 3] * a
        W[0, 0], W[0, 1], W[0, 2] = 0.0, -w[2], w[1]
        W[1, 0], W[1, 1], W[1, 2] = w[2], 0.0, -w[0]
        W[2, 0], W[2, 1], W[2, 2] = -w[1], w[0], 0.0
        sine, versed = math.sin(q[k]), 1.0 - math.cos(q[k])
        for i in range(3):
            E[i, 3] = 0.0
            for j in range(3):
                square = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
                one = 1.0 if i == j else 0.0
                E[i, j] = one + sine * W[i, j] + versed * square
                E[i, 3] += (q[k] * one + versed * W[i, j] + (q[k] - sine) * square) * v[j]
        _move(T, E)
    _move(T, home)


@piece
def _move(T, E):
    """T becomes T E, both without the last row."""
    for i in range(3):
        a, b, c = T[i, 0], T[i, 1], T[i, 2]
        for j in range(4):
            T[i, j] = a * E[0, j] + b * E[1, j] + c * E[2, j] + (T[i, 3] if j == 3 else 0.0)


@piece
def _error(T, position, rotation, e):
    """The reference from the tool: position, then rotation vector."""
    turn = np.empty((3, 3))
    for i in range(3):
        e[i] = position[i] - T[i, 3]
        for j in range(3):
            turn[i, j] = rotation[i, 0] * T[j, 0] + rotation[i, 1] * T[j, 1] + rotation[i, 2] * T[j, 2]
    e[3], e[4], e[5] = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    sine = 0.5 * math.sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    if sine < 1e-9 and cosine < 0.0:  # half a turn
        k, longest = 0, turn[0, 0]
        for i in range(1, 3):
            if turn[i, i] > longest:
                k, longest = i, turn[i, i]
        turn[k, k] += 1.0
        norm = math.sqrt(turn[0, k] * turn[0, k] + turn[1, k] * turn[1, k] + turn[2, k] * turn[2, k])
        for i in range(3):
            e[3 + i] = math.pi * turn[i, k] / norm
        return
    ratio = 1.0 if sine < 1e-9 else math.atan2(sine, cosine) / sine
    for i in range(3, 6):
        e[i] *= 0.5 * ratio


@piece
def _cholesky(M, L):
    """L of M = L Lᵀ; False where there is none."""
    for i in range(len(M)):
        for j in range(i + 1):
            rest = M[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = rest / L[j, j]
            elif rest > 0.0:
                L[i, i] = math.sqrt(rest)
            else:
                return False
    return True


@piece
def _rotate(C, P):
    """Turn the rows of C `(6, J)` until they are orthogonal; the same turns of the rows of P."""
    n = C.shape[1]
    for _ in range(SWEEPS):
        done = True
        for a in range(5):
            for b in range(a + 1, 6):
                aa, bb, ab = 0.0, 0.0, 0.0
                for j in range(n):
                    aa += C[a, j] * C[a, j]
                    bb += C[b, j] * C[b, j]
                    ab += C[a, j] * C[b, j]
                if abs(ab) <= ROUND_OFF * math.sqrt(aa * bb):
                    continue
                done = False
                zeta = (bb - aa) / (2.0 * ab)
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = c * t
                for j in range(n):
                    x, y = C[a, j], C[b, j]
                    C[a, j], C[b, j] = c * x - s * y, s * x + c * y
                for j in range(6):
                    x, y = P[a, j], P[b, j]
                    P[a, j], P[b, j] = c * x - s * y, s * x + c * y
        if done:
            break


@piece
def _remove(X, y):
    """Take out of y what lies in the span of the rows of X `(6, J)`, by Gram and Schmidt, the longest row first."""
    n, largest = X.shape[1], 0.0
    for _ in range(6):
        best, longest = 0, -1.0
        for a in range(6):
            square = 0.0
            for j in range(n):
                square += X[a, j] * X[a, j]
            if square > longest:
                best, longest = a, square
        largest = max(largest, longest)
        if longest <= SMALL * SMALL * largest or longest == 0.0:
            break
        length = math.sqrt(longest)
        for j in range(n):
            X[best, j] /= length
        unit = X[best].copy()
        for _again in range(2):
            inside = 0.0
            for j in range(n):
                inside += unit[j] * y[j]
            for j in range(n):
                y[j] -= inside * unit[j]
            for a in range(6):
                inside = 0.0
                for j in range(n):
                    inside += unit[j] * X[a, j]
                for j in range(n):
                    X[a, j] -= inside * unit[j]
        for j in range(n):
            X[best, j] = 0.0


def _arms(
    n, q, v, mass, bias, position, rotation, twist, s, share, fixed, axes, home, posture, gains, limit, torque, pose, error,
    wanted, nullspace, fine,
):  # fmt: skip
    J = q.shape[1]
    spatial, X, C, P, L = np.empty((6, J)), np.empty((6, J)), np.empty((6, J)), np.empty((6, 6)), np.zeros((J, J))
    speed, push, y, root = np.empty(J), np.empty(J), np.empty(J), np.empty(6)
    damping, spring, damper = gains[0], gains[1], gains[2]
    for i in range(n):
        T, e = pose[i], error[i]
        _pose(q[i], axes, home, spatial, T)
        T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0
        _error(T, position[i], rotation[i], e)
        fine[i] = _cholesky(mass[i], L)
        if not fine[i]:
            continue
        for j in range(J):  # the velocity of the tool, not of the point in the origin
            a, b, c = spatial[3, j], spatial[4, j], spatial[5, j]
            spatial[0, j] += b * T[2, 3] - c * T[1, 3]
            spatial[1, j] += c * T[0, 3] - a * T[2, 3]
            spatial[2, j] += a * T[1, 3] - b * T[0, 3]
        stiff = True
        for d in range(6):
            root[d] = math.sqrt(fixed[d] + share[d] * s[i])
            stiff = stiff and root[d] > 0.0
            for j in range(J):  # X Lᵀ = J
                rest = spatial[d, j]
                for k in range(j):
                    rest -= L[j, k] * X[d, k]
                X[d, j] = rest / L[j, j]
                C[d, j] = root[d] * X[d, j]
            for k in range(6):
                P[d, k] = 1.0 if d == k else 0.0
        _rotate(C, P)
        for j in range(J):
            speed[j] = 0.0
            push[j] = 0.0
            for k in range(j, J):
                speed[j] += L[k, j] * v[i, k]
        largest = 0.0
        for d in range(6):
            square = 0.0
            for j in range(J):
                square += C[d, j] * C[d, j]
            largest = max(largest, square)
        for j in range(J):  # L y = what draws to the posture
            rest = spring * (posture[j] - q[i, j]) - damper * v[i, j]
            for k in range(j):
                rest -= L[j, k] * y[k]
            y[j] = rest / L[j, j]
        for d in range(6):
            square, along, asked = 0.0, 0.0, 0.0
            for j in range(J):
                square += C[d, j] * C[d, j]
                along += C[d, j] * speed[j]
            if square <= SMALL * SMALL * largest or square == 0.0:
                continue
            for k in range(6):
                asked += P[d, k] * root[k] * twist[i, k]
            part, inside = (along - asked) / math.sqrt(square), 0.0
            for j in range(J):
                push[j] += C[d, j] * part
                inside += C[d, j] * y[j]
            if stiff:  # C spans what the task can move
                for j in range(J):
                    y[j] -= inside / square * C[d, j]
        if not stiff:
            _remove(X, y)
        for j in range(J):
            total = bias[i, j]
            nullspace[i, j] = 0.0
            for d in range(6):
                total += spatial[d, j] * (root[d] * root[d]) * e[d]
            for k in range(j + 1):
                total -= 2.0 * damping * L[j, k] * push[k]
                nullspace[i, j] += L[j, k] * y[k]
            wanted[i, j] = total + nullspace[i, j]
            torque[i, j] = min(max(wanted[i, j], -limit[j]), limit[j])
