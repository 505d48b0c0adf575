"""A policy as a header for C and C++: no allocation, no dependency but math.h, doubles throughout. `torchds.export` writes it.

Stability: experimental.
"""

from __future__ import annotations

import re

import numpy as np

from torchds.control.controller import arrays_of
from torchds.control.plan import plan
from torchds.errors import InvalidArgumentError
from torchds.policy import GMRPolicy

TEMPLATE = """\
/* A policy of torchds: velocities and stiffness from the position, [v; s] = sum_k h_k(x) (A_k x + b_k).
   {about}
   C99 and C++, nothing is allocated, nothing is shared: it may run in any thread. */
#ifndef {guard}
#define {guard}

#include <math.h>

enum {{ {name}_inputs = {D}, {name}_velocities = {O}, {name}_stiffnesses = {Q} }};

/* y[0] to y[{last_v}] are the velocities at x, {stiffness}. */
static inline void {name}_evaluate(const double *x, double *y)
{{
    static const double center[{D}] = {{{center}}};
    static const double factors[{K}][{D}][{D}] = {{{factors}}};
    static const double offset[{K}][{D}] = {{{offset}}};
    static const double log_scale[{K}] = {{{log_scale}}};
    static const double rows[{outputs}][{K}][{D1}] = {{{rows}}};
    double h[{K}], highest = 0.0, total = 0.0;
    int k, i, j;

    for (k = 0; k < {K}; k++) {{
        double square = 0.0;
        for (i = 0; i < {D}; i++) {{
            double z = offset[k][i];
            for (j = 0; j < {D}; j++)
                z += factors[k][i][j] * (x[j] - center[j]);
            square += z * z;
        }}
        h[k] = log_scale[k] - 0.5 * square;
        if (k == 0 || h[k] > highest)
            highest = h[k];
    }}
    for (k = 0; k < {K}; k++) {{
        h[k] = exp(h[k] - highest);
        total += h[k];
    }}
    for (i = 0; i < {outputs}; i++) {{
        y[i] = 0.0;
        for (k = 0; k < {K}; k++) {{
            double expert = rows[i][k][{D}];
            for (j = 0; j < {D}; j++)
                expert += rows[i][k][j] * x[j];
            y[i] += h[k] * expert;
        }}
        y[i] /= total;
    }}
}}

/* One step of the motion, x += v dt; y as above, at the x before it. */
static inline void {name}_step(double *x, double dt, double *y)
{{
    int i;

    {name}_evaluate(x, y);
    for (i = 0; i < {D}; i++)
        x[i] += y[i] * dt;
}}

#endif
"""


def header(policy: GMRPolicy, name: str) -> bytes:
    """`NAME_evaluate(x, y)`, `NAME_step(x, dt, y)` and the sizes, as the text of a header.

    Args:
        policy: without a batch; it is taken in double precision.
        name: what the functions begin with; what is no letter or digit becomes _.

    Raises:
        InvalidArgumentError: a batch of policies, or a name that is none in C.
    """
    given, name = name, re.sub(r"\W", "_", name, flags=re.ASCII)
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InvalidArgumentError(
            f"the functions of a header have its name, which has to begin with a letter, got {given!r}"
        )
    made = plan(arrays_of(policy), 1.0)
    K, D, O, Q = made.sizes
    used = np.isfinite(made.log_scale)  # padding has prior zero
    text = TEMPLATE.format(
        name=name,
        guard=f"{name.upper()}_H",
        about=_about(policy),
        K=int(used.sum()),
        D=D,
        D1=D + 1,
        O=O,
        Q=Q,
        outputs=O + Q,
        last_v=O - 1,
        stiffness=f"y[{O}] to y[{O + Q - 1}] the stiffness" if Q else "there is no stiffness",
        center=_numbers(made.center),
        factors=_numbers(made.factors.reshape(K, D, D)[used]),
        offset=_numbers(made.offset.reshape(K, D)[used]),
        log_scale=_numbers(made.log_scale[used]),
        rows=_numbers(made.rows.reshape(O + Q, K, D + 1)[:, used]),
    )
    return text.encode()


def _about(policy: GMRPolicy) -> str:
    """What is known about the policy, in a line of a comment."""
    info = policy.info
    said = [f"inputs {', '.join(info.names)}" * bool(info.names), f"in {info.units}" * bool(info.units)]
    said += [f"time step {info.dt!r} s" * (info.dt is not None)]
    if info.goal is not None:
        said.append(f"goal {info.goal.tolist()}")
    line = "; ".join(filter(None, said)) or "Nothing is said about names, units and goal."
    return re.sub(r"[^\x20-\x7e]|\*/|/\*", "?", line)


def _numbers(array: np.ndarray) -> str:
    """The numbers with all their digits, in braces for each axis but the first."""
    if array.ndim == 1:
        return ", ".join(repr(float(value)) for value in array)
    return ", ".join(f"{{{_numbers(part)}}}" for part in array)
