"""The linear part of a function, told apart from its coefficients.

    tangent of the results = L(coefficients) tangent of the arguments

XLA's CPU compiler would compute coefficients again for every tangent, and linear sums again for
every result that needs them.  Here coefficients are computed once for all tangents, divisions by
them become multiplications, and sums that several results need are kept.

Inside `halved` tangents pass through L in half their precision; coefficients are computed in full.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, JaxprEqn, Literal, Var

from jdem.core.fusion import BOUNDARY, once

KEPT = 4  # operations from which on a sum that several results need is kept

_halved: ContextVar[bool] = ContextVar("halved", default=False)


@contextmanager
def halved() -> Iterator[None]:
    """Passes tangents of kernels that are traced here on as float32 where they are float64."""
    token = _halved.set(True)
    try:
        yield
    finally:
        _halved.reset(token)


def narrowed(leaf):
    """The array in the precision that tangents pass in."""
    double = getattr(leaf, "dtype", None) == jnp.float64
    return jnp.asarray(leaf, jnp.float32) if double and _halved.get() else leaf


def pushed_forward(function: Callable, point: list, tangent: list) -> list:
    """The tangents of function(point), a list of arrays, from a narrowed tangent; narrowed too.

    None stands for a tangent that is zero whatever the point's tangent is.
    """
    _, push = jax.linearize(function, point)
    full = [None if p is None else jax.ShapeDtypeStruct(p.shape, p.dtype) for p in point]
    traced = jax.make_jaxpr(push)(full)
    coefficients = once([narrowed(leaf) for leaf in traced.consts])
    found = _passed(traced.jaxpr, coefficients, [(leaf, 0) for leaf in jax.tree.leaves(tangent)])
    return [None if distance is None else narrowed(value) for value, distance in found]


def _passed(jaxpr: Jaxpr, coefficients: list, tangents: list) -> list:
    """What a linear program makes of tangents: values, and by how many operations each is apart
    from what is kept; for a value that is no tangent that number is None."""
    uses = _uses(jaxpr)
    known: dict[Var, tuple[Any, int | None]] = {}

    def write(variable, value, distance):
        if distance is not None and distance >= KEPT and uses.get(variable, 0) > 1:
            value, distance = once(value), 0
        known[variable] = (value, distance)

    def read(atom):
        return (narrowed(atom.val), None) if isinstance(atom, Literal) else known[atom]

    for variable, value in zip(jaxpr.constvars, coefficients, strict=True):
        write(variable, value, None)
    for variable, given in zip(jaxpr.invars, tangents, strict=True):
        write(variable, *given)
    for equation in jaxpr.eqns:
        results = _results(equation, [read(atom) for atom in equation.invars])
        for variable, found in zip(equation.outvars, results, strict=True):
            write(variable, *found)
    return [read(atom) for atom in jaxpr.outvars]


def _uses(jaxpr: Jaxpr) -> dict[Var, int]:
    """How often each variable is needed."""
    uses: dict[Var, int] = {}
    atoms = [atom for equation in jaxpr.eqns for atom in equation.invars] + list(jaxpr.outvars)
    for atom in atoms:
        if isinstance(atom, Var):
            uses[atom] = uses.get(atom, 0) + 1
    return uses


def _results(equation: JaxprEqn, given: list[tuple[Any, int | None]]) -> list:
    """Results of one operation on values with their distances, likewise."""
    name, params = equation.primitive.name, equation.params
    values, distances = [value for value, _ in given], [distance for _, distance in given]
    if name == "jit":
        found = _passed(params["jaxpr"].jaxpr, params["jaxpr"].consts, given)
        return _kept(found) if params["name"] == BOUNDARY else found
    if name == "optimization_barrier":
        return given
    if name == "div" and distances[0] is not None and distances[1] is None:
        return [(values[0] * once(1 / values[1]), distances[0] + 1)]
    if name == "convert_element_type" and _halved.get() and params["new_dtype"] == jnp.float64:
        params = {**params, "new_dtype": jnp.dtype(jnp.float32)}
    found = equation.primitive.bind(*values, **params)
    apart = [distance for distance in distances if distance is not None]
    distance = 1 + sum(apart) if apart else None
    several = equation.primitive.multiple_results
    return [(value, distance) for value in (found if several else [found])]


def _kept(given: list) -> list:
    """The same, of which tangents are computed once."""
    tangents = iter(once([value for value, distance in given if distance is not None]))
    return [(v, None) if distance is None else (next(tangents), 0) for v, distance in given]
