"""Stop conditions, forces and plants of roll-outs on a GPU, as `torchds.kernels.cpu` has them; parts of `torchds.kernels.cuda`.

`x`, `v` and the like are tuples with an entry for each axis, each of them for all roll-outs of a program. A table is
where it begins, how many columns it has and, where that varies, how many rows; `p` is one of parameters, of which roll-out i
uses column i % (how many).

Stability: experimental.
"""

from __future__ import annotations

from torchds.errors import MissingPackageError
from torchds.kernels import steps

try:
    import triton
    import triton.language as tl
except ImportError as error:
    raise MissingPackageError("triton", "gpu", "compiled code for GPUs") from error

NONE, BOUNDS, WALLS = tl.constexpr(steps.NONE), tl.constexpr(steps.BOUNDS), tl.constexpr(steps.WALLS)
CONSTANT, BEYOND, AWAY = tl.constexpr(steps.CONSTANT), tl.constexpr(steps.BEYOND), tl.constexpr(steps.AWAY)


@triton.jit
def place(table, column, row):
    """Where the entries of one row are."""
    return table[0] + row * tl.cast(table[1], tl.int64) + column


@triton.jit
def read(table, column, first, COUNT: tl.constexpr):
    """Rows `first`, .. of the columns `column`, as a tuple of `COUNT`."""
    values = ()
    for j in tl.static_range(COUNT):
        values += (tl.load(place(table, column, first + j)),)
    return values


@triton.jit
def read_all(table, column, COUNT: tl.constexpr):
    """The first `COUNT` rows: one load that is halved until its parts are rows, for Triton is slow with many loads."""
    WIDTH: tl.constexpr = triton.next_power_of_2(COUNT)
    row = tl.minimum(tl.arange(0, WIDTH), COUNT - 1)
    parts = (tl.trans(tl.load(place(table, column[None, :], row[:, None]))),)
    for j in tl.static_range(16):
        if 2**j < COUNT:
            even, odd = (), ()
            for m in tl.static_range(2**j):
                halves = tl.split(tl.reshape(parts[m], (column.shape[0], WIDTH // 2 ** (j + 1), 2)))
                even += (halves[0],)
                odd += (halves[1],)
            parts = even + odd
    values = ()
    for j in tl.static_range(COUNT):
        values += (tl.reshape(parts[j], column.shape),)
    return values


@triton.jit
def write(table, column, first, values, COUNT: tl.constexpr):
    """The reverse, to rows `first`, .."""
    for j in tl.static_range(COUNT):
        tl.store(place(table, column, first + j), values[j])


@triton.jit
def added(a, b, COUNT: tl.constexpr):
    """The sums of the entries of two tuples."""
    sums = ()
    for d in tl.static_range(COUNT):
        sums += (a[d] + b[d],)
    return sums


@triton.jit
def clamp(value, low, high):
    """`value` cut to [low, high]; not a number stays that."""
    value = tl.where(value < low, low, value)
    return tl.where(value > high, high, value)


@triton.jit
def stop_step(KIND: tl.constexpr, p, i, x, x_next, D: tl.constexpr):
    """Whether the step from `x` to `x_next` must not be taken."""
    column = i % p[1]
    stops = column < 0
    if KIND == BOUNDS:  # low, high of each axis
        limits = read(p, column, 0, 2 * D)
        for d in tl.static_range(D):
            inside = (limits[d] <= x_next[d]) & (x_next[d] <= limits[D + d])
            stops = stops | (inside == 0)
    if KIND == WALLS:  # two ends of each wall
        a0, a1, b0, b1 = x[0], x[1], x_next[0], x_next[1]
        for w in range(0, p[2], 4):
            p0, p1, q0, q1 = read(p, column, w, 4)
            side_a = (q0 - p0) * (a1 - p1) - (q1 - p1) * (a0 - p0)
            side_b = (q0 - p0) * (b1 - p1) - (q1 - p1) * (b0 - p0)
            side_p = (b0 - a0) * (p1 - a1) - (b1 - a1) * (p0 - a0)
            side_q = (b0 - a0) * (q1 - a1) - (b1 - a1) * (q0 - a0)
            near0 = (tl.minimum(a0, b0) <= tl.maximum(p0, q0)) & (tl.maximum(a0, b0) >= tl.minimum(p0, q0))
            near1 = (tl.minimum(a1, b1) <= tl.maximum(p1, q1)) & (tl.maximum(a1, b1) >= tl.minimum(p1, q1))
            stops = stops | ((side_a * side_b <= 0) & (side_p * side_q <= 0) & near0 & near1)
    return stops


@triton.jit
def force_step(KIND: tl.constexpr, p, i, x, D: tl.constexpr):
    """The external force at positions `x`."""
    force = ()
    if KIND != NONE:
        column = i % p[1]
    if KIND == CONSTANT:  # the force
        force = read(p, column, 0, D)
    elif KIND == BEYOND:  # border, axis, the force beyond it
        border, axis = read(p, column, 0, 2)
        beyond = column < 0
        for d in tl.static_range(D):
            beyond = beyond | ((axis == d) & (x[d] > border))
        for d in tl.static_range(D):
            force += (tl.where(beyond, tl.load(place(p, column, 2 + d)), 0.0),)
    elif KIND == NONE:
        for d in tl.static_range(D):
            force += (tl.full(x[d].shape, 0.0, x[d].dtype),)
    else:  # gain, points of a path, their squares, their normals
        n_points = (p[2] - 1) // (2 * D + 1)
        nearest = column * 0
        least = tl.full(x[0].shape, float("inf"), x[0].dtype)
        for j in range(n_points):
            point = read(p, column, 1 + j * D, D)
            product = x[0] * point[0]
            for d in tl.static_range(1, D):
                product += x[d] * point[d]
            distance = tl.load(place(p, column, 1 + n_points * D + j)) - 2.0 * product
            nearer = (distance < least) | ((distance != distance) & (least == least))
            nearest = tl.where(nearer, j, nearest)
            least = tl.where(nearer, distance, least)
        gain = tl.load(place(p, column, 0))
        offset = ()
        for d in tl.static_range(D):
            offset += (x[d] - tl.load(place(p, column, 1 + nearest * D + d)),)
        if KIND == AWAY:
            for d in tl.static_range(D):
                force += (gain * offset[d],)
        else:
            normal = read(p, column, 1 + n_points * (D + 1) + nearest * D, D)
            square = offset[0] * offset[0]
            side = normal[0] * offset[0]
            for d in tl.static_range(1, D):
                square += offset[d] * offset[d]
                side += normal[d] * offset[d]
            size = gain * tl.sqrt(square) * tl.where(side > 0, 1.0, tl.where(side < 0, -1.0, side))
            for d in tl.static_range(D):
                force += (size * normal[d],)
    return force


@triton.jit
def plant_step(
    p, i, before, external, x_before, x, v_before, v, stiffness, t, dt, CHANCE: tl.constexpr, D: tl.constexpr, Q: tl.constexpr
):  # fmt: skip
    """The state of a point mass under impedance control after one step, `ImpedanceControlled.step`.

    `before` and the result are position, velocity, acceleration and stiffness of each axis, all positions first; `t` is the
    number of the step.
    """
    column = i % p[1]
    m, damping, explicit, low, high, max_rate, constant = read(p, column, 0, 7)
    each = read(p, column, 7, D)
    positions, speeds, accelerations, applied, force = (), (), (), (), external
    seen, seen_speeds = before[:D], before[D : 2 * D]
    if CHANCE:
        now, last = 7 + D + 3 * D * t, p[2] - 3 * D
        drawn, wrong = read(p, column, tl.minimum(now, last), 3 * D), ()
        for d in tl.static_range(3 * D):
            wrong += (tl.where(now <= last, drawn[d], 0.0),)
        seen, seen_speeds = added(seen, wrong[:D], D), added(seen_speeds, wrong[D : 2 * D], D)
        force = added(force, wrong[2 * D :], D)
    for d in tl.static_range(D):
        s = each[d]
        for q in tl.static_range(Q):
            s = tl.where((constant == 0) & (each[d] == q), clamp(stiffness[q], low, high), s)
        last, most = before[3 * D + d], max_rate * dt
        slower = last + clamp(s - last, -most, most)
        s = tl.where((t > 0) & (max_rate < float("inf")), slower, s)
        brake = 2.0 * tl.sqrt(s * m)
        position, speed = before[d], before[D + d]
        away = tl.where(explicit != 0, x[d] - seen[d], x_before[d] - seen[d] - dt * speed)
        slip = tl.where(explicit != 0, v[d], v_before[d]) - seen_speeds[d]
        inertia = tl.where(explicit != 0, m, m + s * dt * dt + brake * dt)
        a = (s * away + brake * slip + force[d] - damping * speed) / inertia
        new = speed + a * dt
        positions += (position + new * dt,)
        speeds += (new,)
        accelerations += (a,)
        applied += (s,)
    return positions + speeds + accelerations + applied + force
