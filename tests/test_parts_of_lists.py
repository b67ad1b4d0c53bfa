"""A pair list taken in halves and blocks, and the options that let halves run together."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_made_beds import bed_of, cohesive_soil, heap, ran, spheres_of, state_of

from jdem import neighbors
from jdem.dynamics import Command, step
from jdem.program import program
from jdem.simulate import Segment, run, stack
from jdem.smooth import Smoothing


@pytest.mark.parametrize(
    ("split", "block", "parts"), [(99, 5, (1, 4)), (4, 9, (2, 1)), (4, 5, (2, 2))]
)
def test_parts_of_a_pair_list_add_up_to_the_whole(split, block, parts, monkeypatch):
    """Of sixteen pairs, some of them unused; what differs is the order of additions."""
    bed = bed_of(spheres_of(4), cohesive_soil(), smoothing=Smoothing())
    state = ran(bed, state_of(bed, heap()), 8).state
    zero = jnp.zeros(())
    command = Command(zero, zero, zero, zero)

    def later():
        def advance(_, state):
            return step(bed, state, command)

        return eqx.filter_jit(lambda s: jax.lax.fori_loop(0, 20, advance, s))(state)

    whole = later()
    monkeypatch.setattr(neighbors, "SPLIT", split)
    monkeypatch.setattr(neighbors, "BLOCK", block)
    assert neighbors.blocks_of(bed.grid.pairs) == parts
    for ours, expected in zip(*map(jax.tree.leaves, (later(), whole)), strict=True):
        scale = np.abs(np.asarray(expected)).max()
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-9 * scale)
    assert np.asarray(whole.pairs.history.max_overlap).max() > 0, "nothing touched"


def test_a_list_that_divides_into_parts_is_hardly_longer():
    for wanted in (1, 2047, 2048, 8191, 8193, 16_500, 66_000):
        capacity = neighbors.in_blocks(wanted)
        halves, blocks = neighbors.blocks_of(capacity)
        assert wanted <= capacity < wanted + halves * blocks
        assert capacity <= halves * blocks * neighbors.BLOCK
        assert (halves == 1) == (wanted < neighbors.SPLIT)
        assert (blocks == 1) == (wanted <= halves * neighbors.BLOCK)
    assert neighbors.blocks_of(4097) == (1, 1), "halves of a list of odd length"


def test_the_compilers_options_change_no_digit():
    bed = bed_of(spheres_of(4), cohesive_soil(), smoothing=Smoothing())
    arguments = (bed, state_of(bed, heap()), stack([Segment(duration=1.0)]), jnp.asarray(20))
    found = [jit(lambda *given: run(*given, 4))(*arguments) for jit in (program, eqx.filter_jit)]
    assert int(found[0].samples.segment[3]) == 0, "four samples"
    for ours, expected in zip(*map(jax.tree.leaves, found), strict=True):
        np.testing.assert_array_equal(ours, expected)
