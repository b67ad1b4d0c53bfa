"""Tangents of a kernel are those of its function, and its values do not notice them."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.core.fusion import fenced, once
from jdem.core.kernel import BLOCK, entrywise, together
from jdem.core.linear import halved
from jdem.core.vector import Vector
from jdem.engine.loop import run, start
from jdem.engine.segment import cell_segment, stack
from jdem.engine.state import TangentDrag
from jdem.sensitivity.overdamped import OverdampedMotion
from tests import ROOT
from tests.support.hand_made_beds import RADIUS, bed_of, soil_of, spheres_of

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("cheaply_compiled")]

LENGTHS = (1, 7, BLOCK, BLOCK + 1, 3 * BLOCK)


def contact(shared, entries):
    """Something like a contact law: gathers, branches, quotients, a count beside numbers."""
    rows, stiffness, counts = shared
    first, overlap, number = entries
    place = once(rows[first].T)
    depth = jnp.where(overlap > 0, overlap, 0.0)
    push = once(stiffness * depth * jnp.sqrt(depth + 1e-3) / (2.0 + jnp.sin(place[0])))
    share = jnp.where(push > 1.0, push / (1.0 + push * push), push * push) / stiffness
    return {
        "row": jnp.stack([push * place[1], share, share - push / place[2]], axis=-1),
        "number": number + counts,
        "push": push,
    }


def given(length: int):
    draw = np.random.default_rng(length)
    rows = jnp.asarray(draw.normal(size=(20, 3)) + 3.0)
    first = jnp.asarray(draw.integers(0, 20, length))
    overlap = jnp.asarray(draw.normal(size=length))
    number = jnp.arange(length)
    return (rows, jnp.asarray(3.0), jnp.asarray(2)), (first, overlap, number)


def results(rows, stiffness, overlap, length, kernel):
    (_, _, counts), (first, _, number) = given(length)
    arguments = (rows, stiffness, counts), (first, overlap, number)
    if not kernel:
        return contact(*arguments)
    with fenced():
        return entrywise(contact, *arguments)


def floats(tree):
    return [leaf for leaf in jax.tree.leaves(tree) if leaf.dtype != jax.dtypes.float0]


def tangents_of(function, point, directions):
    """Values, and tangents along all directions."""

    def push(direction):
        values, tangents = jax.jvp(function, point, direction)
        return values, floats(tangents)

    return jax.jit(jax.vmap(push, out_axes=(None, 0)))(directions)


def case(length: int):
    (rows, stiffness, _), (_, overlap, _) = given(length)
    point = (rows, stiffness, overlap)
    draw = np.random.default_rng(length + 1)
    return point, tuple(jnp.asarray(draw.normal(size=(3, *leaf.shape))) for leaf in point)


@pytest.mark.parametrize("length", LENGTHS)
def test_tangents_are_those_of_the_function(length):
    point, directions = case(length)
    for kernel in (True, False):
        found = tangents_of(lambda *p, k=kernel: results(*p, length, k), point, directions)
        if kernel:
            of_kernel = found
    for ours, theirs in zip(jax.tree.leaves(of_kernel), jax.tree.leaves(found), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("length", LENGTHS)
def test_values_do_not_notice_tangents(length):
    point, directions = case(length)
    alone = jax.jit(lambda *p: results(*p, length, True))(*point)
    beside, _ = tangents_of(lambda *p: results(*p, length, True), point, directions)
    assert jax.tree.all(jax.tree.map(np.array_equal, alone, beside))


def test_tangents_of_half_the_precision():
    point, directions = case(2 * BLOCK)
    full = tangents_of(lambda *p: results(*p, 2 * BLOCK, True), point, directions)
    with halved():
        half = tangents_of(lambda *p: results(*p, 2 * BLOCK, True), point, directions)
    assert jax.tree.all(jax.tree.map(np.array_equal, half[0], full[0]))
    for ours, theirs in zip(half[1], full[1], strict=True):
        assert ours.dtype == theirs.dtype
        assert 0 < np.abs(ours - theirs).max() < 1e-5 * np.abs(theirs).max()


def test_what_does_not_move_has_no_tangent():
    """Zero where only an integer or nothing that matters changes; lanes over lanes agree."""
    (rows, stiffness, overlap), _ = case(BLOCK + 1)

    def of(scale, stiffness):
        with fenced():
            return together(lambda a, n: (a * n, n + 1), stiffness, jnp.asarray(3)), scale

    tangents = jax.jit(lambda s: jax.jvp(lambda s: of(s, stiffness), (s,), (s,))[1])(1.0)
    assert tangents[0][0] == 0

    def slope(stiffness):
        function = lambda s: results(rows, s, overlap, BLOCK + 1, True)["row"]  # noqa: E731
        return jax.vmap(lambda t: jax.jvp(function, (stiffness,), (t,))[1])(jnp.ones(2))

    several = jax.jit(jax.vmap(slope))(jnp.asarray([2.0, 3.0]))
    for one, stiffness in zip(several, (2.0, 3.0), strict=True):
        np.testing.assert_allclose(one, jax.jit(slope)(jnp.asarray(stiffness)), rtol=1e-12)


@pytest.mark.rare
@pytest.mark.slow
def test_a_run_does_not_notice_tangents():
    """Samples and final state of spheres pressed together, bit for bit.

    Without fused multiply-adds, which only a new process can be without: which of two products in
    a sum is fused, the compiler decides anew in every program, so on processors with AVX2 alone
    values may differ by rounding.
    """
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_max_isa=AVX"
    subprocess.run(
        [
            sys.executable,
            "-c",
            "from tests.jdem.core.test_tangent_kernel import compared; compared()",
        ],
        env={**os.environ, "XLA_FLAGS": flags},
        cwd=ROOT,
        check=True,
    )


def compared():
    """The comparison of that test; raises where something differs."""
    jax.config.update("jax_enable_x64", True)
    places = np.stack(np.meshgrid(*[np.arange(5)] * 3, indexing="ij"), -1).reshape(-1, 3)
    shift = np.random.default_rng(0).normal(size=places.shape)
    positions = Vector.from_rows(jnp.asarray(RADIUS * (1.9 * places + 1.0 + 0.1 * shift)))
    spheres = spheres_of(len(places))

    def simulated(x):
        soil = soil_of(surface_energy=5.0 * (1 + x[0]), plasticity_ratio=0.4 * (1 + x[1]))
        bed = bed_of(spheres, soil, skin=0.3)
        state = start(bed, positions, 12 * RADIUS, 12 * RADIUS)
        programme = stack([cell_segment(platen_speed=0.5, duration=1.0, damping=10.0)])
        way = OverdampedMotion(TangentDrag(500.0, 0.15), turning=())
        record = run(bed, state, programme, jnp.asarray(20), 5, None, way)
        return record.samples, record.state

    point = jnp.asarray([0.1, -0.2])
    alone = jax.jit(simulated)(point)
    beside, slopes = tangents_of(simulated, (point,), (jnp.eye(2),))
    assert jax.tree.all(jax.tree.map(np.array_equal, alone, beside))
    assert max(float(np.abs(slope).max()) for slope in slopes) > 0
