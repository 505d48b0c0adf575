"""Roll-outs on a GPU: one loop over time for 32 roll-outs at once, compiled by Triton; the same as `torchds.kernels.cpu.roll`.

All loops but those over time, walls and points of a path are unrolled. See `torchds.kernels.cuda_steps` for tables.

Stability: experimental.
"""

from __future__ import annotations

from torchds.kernels.cuda_steps import clamp, force_step, place, plant_step, read_all, stop_step, tl, triton, write

# One kernel for all of these numbers: Triton would make others for 1 and for multiples of 16.
COUNTED = ["steps", "points", "gates", "starts", "shifts", "stops", "limits", "plants", "numbers", "forces", "pushes"]
NUMBERS = ["n", *(f"n_{name}" for name in COUNTED)]


@triton.jit
def activate(x, center, factors, offset, log_scale, limit, K: tl.constexpr, D: tl.constexpr):
    """h_k(x) of Eq. 2, as `GMRPolicy.gating` has it: distances are cut only where their squares are infinite."""
    away, powers, grown, h = (), (), (), ()
    for d in tl.static_range(D):
        away += (clamp(x[d] - center[d], -limit, limit),)
    highest = tl.full(x[0].shape, -float("inf"), x[0].dtype)
    for k in tl.static_range(K):
        square = 0.0
        for j in tl.static_range(D):
            a = offset[k * D + j]
            for d in tl.static_range(D):
                a += factors[(k * D + j) * D + d] * away[d]
            a = clamp(a, -limit, limit)
            square += a * a
        power = log_scale[k] - 0.5 * square
        highest = tl.where(power > highest, power, highest)
        powers += (power,)
    total = 0.0
    for k in tl.static_range(K):
        grown += (tl.exp(powers[k] - highest),)
        total += grown[k]
    scale = 1.0 / total
    for k in tl.static_range(K):
        h += (grown[k] * scale,)
    return h


@triton.jit
def outputs(x, h, rows, FIRST: tl.constexpr, LAST: tl.constexpr, K: tl.constexpr, D: tl.constexpr):
    """Outputs `FIRST` ≤ o < `LAST`: rows times h_k [x, 1], nothing for h = 0, however far x is."""
    y = ()
    for o in tl.static_range(FIRST, LAST):
        value = 0.0
        for k in tl.static_range(K):
            part = rows[(o * K + k) * (D + 1) + D] * h[k]
            for d in tl.static_range(D):
                part += rows[(o * K + k) * (D + 1) + d] * (h[k] * x[d])
            value += part
        y += (value,)
    return y


@triton.jit
def held(rests, value, at_rest, COUNT: tl.constexpr):
    """The entries of `value`, or of `at_rest` where a roll-out rests."""
    entries = ()
    for d in tl.static_range(COUNT):
        entries += (tl.where(rests, at_rest[d], value[d]),)
    return entries


@triton.jit(do_not_specialize=NUMBERS)
def roll(
    n, n_steps, n_points, dt: tl.float64, rows, gates, n_gates, start, n_starts, shift, n_shifts, begin, path, resting,
    stop, n_stops, n_limits, plant, n_plants, n_numbers, force, n_forces, n_pushes,
    STOP: tl.constexpr, FORCE: tl.constexpr, CHANCE: tl.constexpr,
    K: tl.constexpr, D: tl.constexpr, O: tl.constexpr, Q: tl.constexpr, LIMIT: tl.constexpr, TOGETHER: tl.constexpr,
):  # fmt: skip
    """`TOGETHER` of `n` roll-outs of `torchds.rollout`; those behind the last one are the last one again.

    `path` receives, of each time, x, the state of the plant before the step, and v, h and the stiffness of the step.
    """
    i = tl.minimum(tl.program_id(0).to(tl.int64) * TOGETHER + tl.arange(0, TOGETHER), n - 1)
    policy = i // n_points
    R = read_all((rows, 1), policy * ((O + Q) * K * (D + 1)), (O + Q) * K * (D + 1))  # one after the other: no table
    G = read_all((gates, n_gates), policy % n_gates, D + K * (D * D + D + 1))
    center, factors, offset, log_scale = G[:D], G[D : D + K * D * D], G[D + K * D * D : -K], G[-K:]
    x = read_all((start, n_starts), i % n_starts, D)
    kind = x[0].dtype
    zero = tl.full((TOGETHER,), 0.0, kind)
    dt, limit = tl.full((TOGETHER,), dt, kind), tl.full((TOGETHER,), LIMIT, kind)
    shifted, v, rests, tracked = (zero,) * D, (zero,) * O, i < 0, ()
    if shift is not None:
        shifted = read_all((shift, n_shifts), i % n_shifts, D)
    if begin is not None:
        tracked = read_all((begin, n), i, 5 * D)
    kept: tl.constexpr = D if begin is None else 6 * D
    size: tl.constexpr = kept + O + K + Q
    for t in range(n_steps):
        seen, x_next = (), ()
        for d in tl.static_range(D):
            seen += (x[d] - shifted[d],)
        h = activate(seen, center, factors, offset, log_scale, limit, K, D)
        y, s = outputs(seen, h, R, 0, O, K, D), outputs(seen, h, R, O, O + Q, K, D)
        for d in tl.static_range(D):
            x_next += (x[d] + dt * y[d],)
        if stop is not None:
            rests = rests | stop_step(STOP, (stop, n_stops, n_limits), i, x, x_next, D)
            x_next, y = held(rests, x_next, x, D), held(rests, y, (zero,) * O, O)
            tl.store(place((resting, n), i, t), rests)
        write((path, n), i, t * size, x + tracked + y + h + s, size)
        if plant is not None:
            external = force_step(FORCE, (force, n_forces, n_pushes), i, tracked, D)
            tracked = plant_step(
                (plant, n_plants, n_numbers), i, tracked, external, x, x_next, v, y, s, t, dt, CHANCE, D, Q
            )
        x, v = x_next, y
    write((path, n), i, n_steps * size, x + tracked, kept)
