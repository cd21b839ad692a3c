"""Inverse dynamics as a Python module and as a C function, to run without excitant."""

from __future__ import annotations

import keyword
import re

from excitant.identify.export.bodies import Tree
from excitant.identify.export.recursion import StraightLine, inverse_dynamics

_PYTHON = '''\
"""Inverse dynamics of {name}, identified by excitant. Needs NumPy only.

tau = inverse_dynamics(q, dq, ddq): recursive Newton-Euler with the identified inertias, friction,
rotor inertia and offsets put in as numbers; rad, N·m (m, N for joints that slide), seconds.
Joints, in order: {joints}.
"""

import math

import numpy as np

N = {n}
JOINTS = {names}


def inverse_dynamics(q, dq, ddq):
    """Torque of all joints, shape (N,), or (n, N) for n states at once."""
    state = [np.asarray(x, dtype=float) for x in (q, dq, ddq)]
    if any(x.shape != state[0].shape or x.shape[-1:] != (N,) for x in state):
        raise ValueError(f"q, dq and ddq must all have shape ({{N}},) or (n, {{N}})")
    if state[0].ndim == 1:
        return np.array(_torque(math, _sign, *(x.tolist() for x in state)))
    columns = [np.moveaxis(x, -1, 0) for x in state]
    tau = _torque(np, np.sign, *columns)
    return np.stack([np.broadcast_to(x, state[0].shape[:-1]) for x in tau], axis=-1)


def _sign(x):
    return (x > 0) - (x < 0)


def _torque(library, sign, q, dq, ddq):
{body}
    return {tau}
'''

_C_SOURCE = """\
/* Inverse dynamics of {name}, identified by excitant. See {header}. */

#include "{header}"

#include <math.h>
{sign}
void {function}(const double q[{size}], const double dq[{size}],
    const double ddq[{size}], double tau[{size}])
{{
{body}
}}
"""

_C_SIGN = """
static double sign(double x)
{
    return (double)((x > 0.0) - (x < 0.0));
}
"""

_C_HEADER = """\
/* Inverse dynamics of {name}, identified by excitant. C99, no allocation, no state.
 *
 * Recursive Newton-Euler with the identified inertias, friction, rotor inertia and offsets put
 * in as numbers; rad, N m (m, N for joints that slide), seconds. Joints, in order:
{joints}
 */

#ifndef {guard}
#define {guard}

#define {size} {n}

#ifdef __cplusplus
extern "C" {{
#endif

void {function}(const double q[{size}], const double dq[{size}],
    const double ddq[{size}], double tau[{size}]);

#ifdef __cplusplus
}}
#endif

#endif
"""


def python_module(arm: Tree) -> str:
    """Source of a Python module with ``inverse_dynamics(q, dq, ddq)``; it needs NumPy only.

    Raises:
        BadInput: An effect that is not a formula of one joint's own motion.
    """
    code = inverse_dynamics(arm)
    lines = [f"{f} = library.{f}" for f in code.functions if f not in ("sign", "pow")]
    for x in ("q", "dq", "ddq"):
        lines.append(f"{', '.join(_inputs(arm, x))}{',' if len(arm.bodies) == 1 else ''} = {x}")
    lines += _statements(code, "# {}", "{} = {}")
    return _PYTHON.format(
        name=_plain(arm.name),
        joints=", ".join(_plain(body.joint) for body in arm.bodies),
        n=len(arm.bodies),
        names=repr(tuple(body.joint for body in arm.bodies)),
        body="\n".join(f"    {line}" for line in lines),
        tau=f"[{', '.join(tau.text for tau in code.tau)}]",
    )


def c_function(arm: Tree, stem: str) -> tuple[str, str]:
    """Source and header of the C function ``<name>_inverse_dynamics``.

    Args:
        arm: The model; its name, made an identifier, is the function's.
        stem: File name of the header without ``.h``.

    Raises:
        BadInput: An effect that is not a formula of one joint's own motion.
    """
    code = inverse_dynamics(arm)
    lines = [
        f"const double {name} = {x}[{j}];"
        for x in ("q", "dq", "ddq")
        for j, name in enumerate(_inputs(arm, x))
        if name in code.names
    ]
    lines += [f"(void){x};" for x in ("q", "dq", "ddq") if not code.names & set(_inputs(arm, x))]
    lines += _statements(code, "/* {} */", "const double {} = {};")
    lines += [f"tau[{j}] = {tau.text};" for j, tau in enumerate(code.tau)]
    words = {
        "name": _plain(arm.name),
        "function": f"{identifier(arm.name)}_inverse_dynamics",
        "size": f"{identifier(arm.name).upper()}_JOINTS",
        "header": f"{stem}.h",
    }
    source = _C_SOURCE.format(
        **words,
        sign=_C_SIGN if "sign" in code.functions else "",
        body="\n".join(f"    {line}" for line in lines),
    )
    header = _C_HEADER.format(
        **words,
        joints="\n".join(f" *   {j} {_plain(b.joint)}" for j, b in enumerate(arm.bodies)),
        guard=f"{identifier(arm.name).upper()}_INVERSE_DYNAMICS_H",
        n=len(arm.bodies),
    )
    return source, header


def identifier(name: str) -> str:
    """A name as an identifier of Python and C."""
    word = re.sub(r"[\W_]+", "_", name, flags=re.ASCII).strip("_") or "arm"
    return f"arm_{word}" if word[0].isdigit() or keyword.iskeyword(word) else word


def _inputs(arm: Tree, symbol: str) -> list[str]:
    return [f"{symbol}{j + 1}" for j in range(len(arm.bodies))]


def _statements(code: StraightLine, comment: str, assignment: str) -> list[str]:
    lines, heading = [], ""
    for statement in code.statements:
        if statement.heading != heading:
            heading = statement.heading
            lines.append(comment.format(_plain(heading)))
        lines.append(assignment.format(statement.name, statement.expression.text))
    return lines


def _plain(text: str) -> str:
    """Text that ends no comment and no string."""
    return re.sub(r"[^\w .,:+()\[\]-]", "_", text, flags=re.ASCII)
