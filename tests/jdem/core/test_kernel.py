"""One kernel computes what the function computes, whatever its arguments and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.core import kernel
from jdem.core.fusion import fenced, once
from jdem.core.kernel import BLOCK, block_count, entrywise, in_blocks

LENGTHS = (1, 7, BLOCK, BLOCK + 1, 3 * BLOCK)


def spring(shared, entries):
    """Something like a contact: gathers, a boundary, columns, a tree of results."""
    rows, stiffness, _ = shared
    first, overlap, _ = entries
    place = rows[first]
    push = once(stiffness * jnp.where(overlap > 0, overlap, 0.0) ** 1.5)
    return {"push": jnp.stack([push, jnp.sin(place[:, 0])], axis=-1), "place": place * 2}


def given(length: int):
    draw = np.random.default_rng(length)
    rows = jnp.asarray(draw.normal(size=(20, 3)))
    first = jnp.asarray(draw.integers(0, 20, length))
    overlap = jnp.asarray(draw.normal(size=length))
    return (rows, jnp.asarray(3.0), rows), (first, overlap, overlap)


def in_one_kernel(function, shared, entries):
    with fenced():
        return entrywise(function, shared, entries)


expected = jax.jit(spring)  # the function itself


def summed(stiffness, shared, entries):
    results = in_one_kernel(spring, (shared[0], stiffness, shared[2]), entries)
    return jnp.sum(results["push"])


@pytest.mark.parametrize("length", LENGTHS)
def test_blocks_give_what_the_function_gives(length):
    """Also where arguments are not used, and without `jit`."""
    arguments = given(length)
    found = jax.jit(lambda *a: in_one_kernel(spring, *a))(*arguments)
    plain = in_one_kernel(spring, *arguments)
    for name, value in expected(*arguments).items():
        np.testing.assert_allclose(found[name], value, rtol=1e-14)
        np.testing.assert_allclose(plain[name], value, rtol=1e-14)


def test_it_is_one_kernel():
    """The compiled program holds one marked call, and no loop of the function outside of it."""
    arguments = given(3 * BLOCK)
    program = jax.jit(lambda *a: in_one_kernel(spring, *a)).lower(*arguments).compile()
    text = str(program.as_text())
    entry = text[text.index("ENTRY") :].splitlines()
    assert sum(" call(" in line and "xla_cpu_small_call" in line for line in entry) == 1
    assert not any(" while(" in line or " fusion(" in line for line in entry)


def test_values_known_at_compile_time_do_not_stop_the_process():
    """XLA writes them into the marked call, whose argument is then not used."""
    shared, entries = given(2 * BLOCK)
    found = jax.jit(lambda: in_one_kernel(spring, shared, entries))()
    np.testing.assert_allclose(found["push"], expected(shared, entries)["push"], rtol=1e-14)


@pytest.mark.parametrize("length", LENGTHS)
def test_derivatives_pass_through(length):
    shared, entries = given(length)
    stiffness = jnp.asarray(3.0)
    found = jax.jit(jax.jacfwd(summed))(stiffness, shared, entries)
    overlap = np.asarray(entries[1])
    np.testing.assert_allclose(found, np.sum(np.maximum(overlap, 0.0) ** 1.5), rtol=1e-12)


def test_lanes_of_vmap_are_computed_each():
    shared, entries = given(BLOCK + 1)
    stiffness = jnp.asarray([1.0, 2.0, 5.0])
    lanes = jax.jit(jax.vmap(summed, (0, None, None)))(stiffness, shared, entries)
    each = [summed(one, shared, entries) for one in stiffness]
    np.testing.assert_allclose(lanes, each, rtol=1e-12)


def test_what_one_kernel_cannot_hold_is_computed_without():
    """Sorting has no place in a kernel: a law that sorts is taken whole."""
    lengths = []

    def sorting(_, values):
        lengths.append(len(values))
        return jnp.sort(values, axis=-1)

    values = jnp.asarray(np.random.default_rng(0).normal(size=(3 * BLOCK, 4)))
    found = jax.jit(lambda v: in_one_kernel(sorting, (), v))(values)
    assert np.array_equal(found, np.sort(values, axis=-1))
    assert lengths[-1] == len(values)


def test_elsewhere_than_in_a_step_there_are_no_blocks(monkeypatch):
    monkeypatch.setattr(kernel, "_Kernel", None)
    arguments = given(3 * BLOCK)
    found = entrywise(spring, *arguments)
    np.testing.assert_allclose(found["place"], expected(*arguments)["place"])


def test_a_list_is_rounded_up_to_whole_blocks():
    for wanted in (1, BLOCK, BLOCK + 1, 16_500, 66_000):
        capacity = in_blocks(wanted)
        assert wanted <= capacity < wanted + BLOCK
        assert (capacity == wanted) or capacity % BLOCK == 0
        assert (block_count(capacity) == 1) == (wanted <= BLOCK)
    assert block_count(2 * BLOCK + 1) == 1, "blocks that are not whole"
