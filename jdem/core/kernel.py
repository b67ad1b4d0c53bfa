"""One kernel: what is computed entry by entry runs as one compiled function, block by block.

XLA's CPU runtime executes a program loop by loop and hands the loops from thread to thread;
at some hundred spheres that takes as long as the arithmetic.  A call marked
`xla_cpu_small_call` is compiled as one function instead, and within it a block of entries
goes through all loops while it is in the processor's cache (timings in
docs/decisions/2026-11-24-beds.md).

The mark is for elementary operations only.  A law of a user that does something else, and
other backends than the CPU, compute as if there were no mark.

Whole programs are compiled for the widest vectors that the processor has (`program`).
"""

from collections.abc import Callable
from functools import partial
from itertools import compress
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun, subjaxprs
from jax.interpreters.partial_eval import dce_jaxpr

from jdem.core.fusion import bounded, fenced, once
from jdem.core.tangents import differentiable

Tree = TypeVar("Tree")

BLOCK = 128  # entries that go through all loops together; half as many with several tangents

_ELEMENTWISE = (
    "abs add add_any and atan2 bitcast_convert_type clamp convert_element_type copy cos div eq "
    "exp exp2 floor ge gt integer_pow is_finite le log log1p expm1 logistic lt max min mul ne neg "
    "not or pow rsqrt select_n shift_left shift_right_arithmetic shift_right_logical sign sin "
    "sqrt square stop_gradient sub tan tanh xor"
)
_ARRANGING = (
    "broadcast_in_dim concatenate dynamic_slice dynamic_update_slice gather optimization_barrier "
    "reshape slice split squeeze stack transpose"
)
_ENCLOSING = "closed_call custom_jvp_call jit scan while"
_COMPILABLE = frozenset(f"{_ELEMENTWISE} {_ARRANGING} {_ENCLOSING}".split())


_WIDEST = {"xla_cpu_prefer_vector_width": 512}  # bits


def program(function: Callable) -> Callable:
    """`function` jitted as `equinox.filter_jit` does it, for vectors of 512 bits on a CPU.

    XLA compiles for 256 bits unless told otherwise; on a processor with AVX-512 a run of 1000
    spheres takes 13 % longer that way, with the same numbers bit for bit.  A processor with
    narrower vectors ignores the wish.
    """
    jitted: Any = eqx.filter_jit  # its signature leaves out the options that it hands on
    options = _WIDEST if jax.default_backend() == "cpu" else {}
    return jitted(function, compiler_options=options)


def entrywise(
    function: Callable[[Any, Any], Tree], shared: Any, entries: Any, used: Array | None = None
) -> Tree:
    """function(shared, entries), where row k of a result depends on `shared` and on entry k.

    `entries`, and what the function returns, are trees of arrays whose first axis counts the
    entries; it is called with some of them at a time.  From entry `used` on, if that is given,
    results are zero, and whole blocks of them are not computed.  Derivatives pass in forward mode.
    """
    if not bounded():
        return function(shared, entries)
    length = jax.tree.leaves(entries)[0].shape[0]
    used = jnp.asarray(length if used is None else used)
    kernels = [partial(_in_blocks, block_count(length, size)) for size in (BLOCK, BLOCK // 2)]
    return differentiable(kernels, used, function, shared, entries)


def _in_blocks(count: int, used: Array, function: Callable, shared, entries):
    """function(shared, entries) as one kernel, or plainly if one cannot hold it."""
    kernel = (
        _Kernel(function, shared, entries)
        if count == 1
        else _Kernel(partial(_blockwise, function, count), (shared, used), entries)
    )
    return kernel() if kernel.possible else function(shared, entries)


@jax.custom_batching.custom_vmap
def most_used(count: Array) -> Array:
    """A number of used entries; of several lists at once the largest, for all of them."""
    return count


@most_used.def_vmap
def _most_of_all(size: int, batched, count: Array):
    return jnp.max(count), False


def together(function: Callable[..., Tree], *arguments: Any) -> Tree:
    """function(*arguments) of a few numbers, as one kernel instead of one for each operation."""
    if not bounded():
        return function(*arguments)
    return differentiable((_at_once, _at_once), None, function, *arguments)


def _at_once(_, function: Callable, *arguments):
    """function(*arguments) as one kernel, or plainly if one cannot hold it."""
    kernel = _Kernel(function, *arguments)
    return kernel() if kernel.possible else function(*arguments)


def block_count(length: int, size: int | None = None) -> int:
    """Blocks of `size` (BLOCK) entries that a list is taken in: 1 unless they are whole."""
    size = BLOCK if size is None else size
    return max(1, length // size) if length % size == 0 else 1


def in_blocks(capacity: int) -> int:
    """The least capacity from `capacity` on that divides into whole blocks, if more than one."""
    return capacity if capacity <= BLOCK else -(-capacity // BLOCK) * BLOCK


def _blockwise(function: Callable, count: int, given, entries):
    """function(shared, entries), blocks of the entries after each other as far as they are used;
    `given` are `shared` and how many entries are."""
    shared, used = given

    def split(leaf: Array) -> Array:
        return leaf.reshape(count, -1, *leaf.shape[1:])

    def joined(leaf: Array) -> Array:
        return leaf.reshape(-1, *leaf.shape[2:])

    leaves, structure = jax.tree.flatten(jax.tree.map(split, entries))

    def computed(number):
        block = [jax.lax.dynamic_index_in_dim(leaf, number, 0, False) for leaf in leaves]
        return function(shared, jax.tree.unflatten(structure, block))

    def with_block(number, made):
        return jax.tree.map(
            lambda rows, one: jax.lax.dynamic_update_index_in_dim(rows, one, number, 0),
            made,
            computed(number),
        )

    shapes = jax.eval_shape(computed, 0)
    blank = jax.tree.map(lambda one: jnp.zeros((count, *one.shape), one.dtype), shapes)
    length = jax.tree.leaves(entries)[0].shape[0] // count
    needed = jnp.minimum(jax.lax.div(used + length - 1, jnp.asarray(length, used.dtype)), count)
    return jax.tree.map(joined, jax.lax.fori_loop(0, needed, with_block, blank))


class _Kernel:
    """A function's call with these arguments as one kernel.

    XLA stops the process where a marked call does not use an argument, or where it knows an
    argument's value at compile time.  So what no result needs is left out first, the rest is
    used by `once` whatever becomes of it, and a barrier hides values from the call.
    """

    def __init__(self, function: Callable, *arguments):
        arrays, static = eqx.partition(arguments, eqx.is_array)
        leaves, structure = jax.tree.flatten(arrays)

        def flat(*leaves):
            return function(*eqx.combine(jax.tree.unflatten(structure, leaves), static))

        traced, shapes = jax.make_jaxpr(flat, return_shape=True)(*leaves)
        needed, used = dce_jaxpr(traced.jaxpr, [True] * len(traced.jaxpr.outvars))
        self._structure = jax.tree.structure(shapes)
        self._operands = [*traced.consts, *compress(leaves, used)]
        self._function = partial(_evaluated, needed, len(traced.consts))
        self.possible = _compilable(needed)

    def __call__(self):
        """The function's results."""
        return jax.tree.unflatten(self._structure, _called(self._function, *self._operands))


def _called(function: Callable, *operands):
    """function(*operands) as a marked call, over several lanes of `vmap` too."""

    @jax.custom_batching.custom_vmap
    def call(*operands):
        return jax.jit(partial(_marked, function))(*operands)

    @call.def_vmap
    def lanes(_, batched, *operands):
        every = jax.vmap(function, [0 if lane else None for lane in batched])
        with fenced():
            found = _called(every, *operands)
        return found, [True] * len(found)

    return call(*operands)


def _marked(function: Callable, *operands):
    """Traced before the mark is set, because a mark holds for everything traced inside."""
    operands = jax.lax.optimization_barrier(operands)
    (call,) = jax.make_jaxpr(jax.jit(function))(*operands).eqns
    with set_xla_metadata(inlineable="false", xla_cpu_small_call="true"):
        return call.primitive.bind(*operands, **call.params)


def _evaluated(jaxpr: Jaxpr, constants: int, *operands):
    operands = once(operands)
    return jaxpr_as_fun(ClosedJaxpr(jaxpr, operands[:constants]))(*operands[constants:])


def _compilable(jaxpr: Jaxpr) -> bool:
    """Whether one kernel can hold all operations."""
    known = all(equation.primitive.name in _COMPILABLE for equation in jaxpr.eqns)
    return known and all(map(_compilable, subjaxprs(jaxpr)))
