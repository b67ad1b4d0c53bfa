"""Hysteretic spring, Hertz-Mindlin, linear cohesion and JKR against their closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.pair import SpherePair, collide, drive_overlap, overlap_path
from jdem.boundaries.composite import BASE
from jdem.core.smooth import Smoothing
from jdem.materials.catalogue import soil_with
from jdem.materials.soil import wall_law
from tests.support.hand_made_beds import advanced, bed_of, spheres_of, state_of
from tests.support.law_cases import MODULUS, MOST, PAIR, RADIUS, SHEAR, YOUNG, law_of, led, named

YIELD, RESTITUTION, COHESION = 8e6, 0.4, 2e5
K1 = 5 * RADIUS / 2 * YIELD
K2 = K1 / RESTITUTION**2
RESIDUAL = (1 - RESTITUTION**2) * MOST  # m, after loading to MOST


def law(**values):
    known = {"yield_strength": YIELD, "restitution": RESTITUTION, "cohesion": 0.0}
    return law_of(soil_with("hysteretic", reference_diameter=2 * RADIUS, **{**known, **values}))


def force_at_end(turns, **values):
    return float(drive_overlap(law(**values), PAIR, overlap_path(jnp.asarray(turns), 50))[-1])


@pytest.mark.parametrize(
    ("turns", "expected"),
    [
        ([MOST], K1 * MOST),
        ([MOST, 0.9 * MOST], K2 * (0.9 * MOST - RESIDUAL)),
        ([MOST, RESIDUAL], 0.0),
        ([MOST, 0.5 * RESIDUAL], 0.0),
        ([MOST, 0.5 * RESIDUAL, 0.5 * RESIDUAL + 1e-6], K2 * 1e-6),  # d0 followed the overlap
        ([MOST, 0.9 * MOST, 0.95 * MOST], K2 * (0.95 * MOST - RESIDUAL)),
        ([MOST, 0.9 * MOST, 1.3 * MOST], K1 * 1.3 * MOST),  # back on the loading line
    ],
)
def test_the_spring_follows_its_lines(turns, expected):
    assert force_at_end(turns) == pytest.approx(expected, rel=1e-9, abs=1e-9 * K1 * MOST)


def test_cohesion_is_its_density_times_the_area():
    pulled = force_at_end([MOST, RESIDUAL], cohesion=COHESION)
    area = np.pi * (RADIUS * RESIDUAL - RESIDUAL**2 / 4)
    assert pulled == pytest.approx(-COHESION * area, rel=1e-9)
    soil = soil_with("hysteretic", cohesion=COHESION, wall_adhesion=0.25)
    assert float(wall_law(soil, 1e-3, Smoothing()).normal.cohesion) == 0.25 * COHESION


@pytest.mark.parametrize("restitution", [0.3, 0.7, 0.95])
def test_a_collision_rebounds_with_the_coefficient_of_restitution(restitution):
    """Whatever its speed: that is what K2 = K1/e^2 is for (Walton and Braun 1986)."""
    fast = law(restitution=restitution)
    step = 0.005 * float(np.sqrt(PAIR.effective_mass() / (K1 / restitution**2)))
    for speed in (0.02, 0.3):
        found = float(jax.jit(collide, static_argnums=4)(fast, PAIR, speed, step, 3000))
        assert found == pytest.approx(restitution, rel=5e-3)


def test_the_dashpot_acts_besides():
    step = 0.01 * float(np.sqrt(PAIR.effective_mass() / K2))
    damped = float(collide(law(damping_factor=1.0), PAIR, 0.1, step, 3000))
    assert damped < 0.7 * RESTITUTION


def test_a_bed_of_it_comes_to_rest():
    soil = soil_with("hysteretic", yield_strength=1e6, platen_friction=0.5, cohesion=1e3)
    bed = bed_of(spheres_of(2), soil, skin=20.0)
    state = state_of(bed, [[0.0, 0.0, 1.0 * RADIUS], [0.0, 0.0, 3.001 * RADIUS]])
    final, _ = advanced(bed, state, 3000, 300.0)
    weight = 9.81 * float(jnp.sum(bed.spheres.mass))
    assert float(final.wall_force[BASE]) == pytest.approx(weight, rel=1e-2)
    assert float(final.pairs.history.normal.max()) > 0


# ------------------------------------------------------------------ Hertz-Mindlin


@pytest.mark.parametrize(
    ("radius", "held", "wall"), [(5e-4, 5e-4, False), (5e-3, 2e-3, False), (5e-4, 1.0, True)]
)
def test_hertz_whatever_the_size(radius, held, wall):
    effective = radius if wall else radius * held / (radius + held)
    depth = 1e-3 * effective
    found = led(named("hertz_mindlin"), [[0, 0], [0, -depth]], radius=radius, held=held, wall=wall)
    expected = 4 / 3 * MODULUS * np.sqrt(effective) * depth**1.5
    assert float(found.normal_force[-1]) == pytest.approx(expected, rel=1e-9)


def test_hertzian_rebounds_are_e_at_every_speed():
    """The contact ends where the overlap does, and pulls before."""
    rebound = jax.jit(collide, static_argnums=4)
    mass = float(PAIR.effective_mass())
    for speed in (0.01, 0.5):
        contact_time = 3 * (mass**2 / (MODULUS**2 * RADIUS / 2 * speed)) ** 0.2
        for restitution in (0.3, 0.8):
            law = named("hertz_mindlin", restitution=restitution)
            found = rebound(law, PAIR, speed, contact_time / 2000, 6000)
            assert float(found) == pytest.approx(restitution, rel=3e-3)


DEEP, SHIFT, LESS = 1e-5, 6e-6, 0.4  # m, m, share of the overlap that unloading leaves
LEFT = {  # share of the force after unloading, and after loading again
    "stretch": (LESS**0.5, 1.0),
    "force": (1.0, 1.0),
    "stretch_rescaled": (LESS, LESS**0.5),
    "force_rescaled": (LESS**0.5, LESS**0.5),
}


@pytest.mark.parametrize("memory", LEFT)
def test_what_the_tangential_spring_keeps(memory):
    """On a wall, where a shift does not change the overlap."""
    law = named("hertz_mindlin", memory=memory, friction=50.0)
    way = [[0, -DEEP], [SHIFT, -DEEP], [SHIFT, -LESS * DEEP], [SHIFT, -DEEP]]
    found = np.asarray(led(law, way, wall=True, friction=50.0).traction)[:, 0]
    held = -8 * SHEAR * np.sqrt(RADIUS * DEEP) * SHIFT
    assert found[1] == pytest.approx(held, rel=1e-9)
    assert found[2:4] / held == pytest.approx(LEFT[memory], rel=1e-6)


GAINS = {  # whether energy comes out of a shift under one load and back under another
    "stretch": (True, False),
    "force": (False, True),
    "stretch_rescaled": (True, False),
    "force_rescaled": (False, False),
}


@pytest.mark.parametrize("memory", GAINS)
def test_changes_of_load_gain_energy_in_all_kinds_but_one(memory):
    """Back under a larger load: S_t u^2/2 has grown.  Under a smaller one: a force that stayed has
    the longer way to go."""
    law = named("hertz_mindlin", memory=memory, friction=50.0)
    for (before, after), gains in zip([(LESS, 1.0), (1.0, LESS)], GAINS[memory], strict=True):
        way = [[0, -before * DEEP], [SHIFT, -before * DEEP], [SHIFT, -after * DEEP]]
        back = [[SHIFT * share, -after * DEEP] for share in (0.75, 0.5, 0.25, 0.0)]
        force = -np.asarray(led(law, [*way, *back], wall=True, friction=50.0).traction)[:7, 0]
        taken, returned = force[1] * SHIFT / 2, np.sum(force[2:6] + force[3:7]) * SHIFT / 8
        assert returned > 1.2 * taken if gains else returned < 0.8 * taken


def test_friction_and_rolling_have_their_limits():
    law = named("hertz_mindlin", rolling_friction=0.1)
    found = led(law, [[0, -DEEP], [1e-4, -DEEP]], [[0, 0, 0], [0, -0.5, 0]], wall=True)
    load = 4 / 3 * MODULUS * np.sqrt(RADIUS) * DEEP**1.5
    assert float(found.traction[-1, 0]) == pytest.approx(-0.5 * load, rel=1e-9)
    assert abs(float(found.moment[-1, 1])) == pytest.approx(0.1 * load * RADIUS, rel=1e-9)


@pytest.mark.parametrize(
    ("radius", "held", "wall"), [(2e-3, 2e-3, False), (5e-3, 2e-3, False), (2e-3, 1.0, True)]
)
def test_linear_cohesion_acts_on_the_circle_of_intersection(radius, held, wall):
    depth = 4e-5
    way = [[0, 0], [0, -depth]]
    with_it, without = (
        float(led(law, way, radius=radius, held=held, wall=wall).normal_force[-1])
        for law in (named("hertz_cohesion", cohesion=2e4), named("hertz_cohesion", cohesion=0.0))
    )
    apart = radius - depth if wall else radius + held - depth
    along = apart if wall else (apart**2 + radius**2 - held**2) / (2 * apart)
    assert without - with_it == pytest.approx(2e4 * np.pi * (radius**2 - along**2), rel=1e-9)


# ------------------------------------------------------------------ JKR

pressed = eqx.filter_jit(drive_overlap)
GAMMA = 0.5
WORK = 2 * GAMMA


def jkr_curve(overlap, effective, modulus=MODULUS, work=WORK):
    """Force by bisection for a (closed forms of Johnson, Kendall and Roberts)."""
    torn = (np.pi * work * effective**2 / (8 * modulus)) ** (1 / 3)
    low, high = torn, 10 * torn + 2 * np.sqrt(effective * max(overlap, 0.0))
    for _ in range(200):
        a = (low + high) / 2
        below = a * a / effective - np.sqrt(2 * np.pi * work * a / modulus) < overlap
        low, high = (a, high) if below else (low, a)
    return 4 * modulus * a**3 / (3 * effective) - np.sqrt(8 * np.pi * work * modulus * a**3)


def jkr_scales(effective, modulus=MODULUS, work=WORK):
    """Pull-off force (N) and the gap of tear-off (m)."""
    torn = (np.pi * work * effective**2 / (8 * modulus)) ** (1 / 3)
    return 1.5 * np.pi * work * effective, 3 * torn**2 / effective


@pytest.mark.parametrize("radius", [1e-6, 2e-3, 0.1])
def test_jkr_s_curve_whatever_the_size(radius):
    """Touching, the pull-off and the tear-off are points of it."""
    pull_off, gap = jkr_scales(radius / 2)
    touched = 1e-12 * gap
    way = np.array([touched, 8.0, 0.0, -0.4807, -0.9, -1 + 1e-8, -1.0001, -0.9, touched, -1.0])
    depths = np.where(way == touched, touched, way * gap)
    spheres = SpherePair(radius)
    force = np.asarray(pressed(named("jkr", gamma=GAMMA), spheres, jnp.asarray(depths))) / pull_off
    expected = np.array([jkr_curve(depth, radius / 2) for depth in depths]) / pull_off
    assert force[:5] == pytest.approx(expected[:5], rel=1e-9)
    assert force[[2, 3]] == pytest.approx([-8 / 9, -1.0], abs=1e-6)
    assert force[5] == pytest.approx(-5 / 9, abs=1e-4)
    assert not force[[6, 7]].any()  # torn off, and not touching again
    assert force[8] == pytest.approx(-8 / 9, abs=1e-6)
    law = named("jkr", gamma=GAMMA).normal
    assert float(law.reach(radius / 2)) == pytest.approx(gap, rel=1e-12)


def test_jkr_touching_and_tearing_off_costs_its_energy():
    """7.092 (w^5 R*^4/E*^2)^(1/3), the area of the curve; nothing before it touches."""
    effective = RADIUS / 2
    pull_off, gap = jkr_scales(effective)
    law = named("jkr", gamma=GAMMA)
    there = np.linspace(-gap, 2 * gap, 4001)[1:]
    back = np.linspace(2 * gap, -1.01 * gap, 40001)[1:]
    overlaps = np.concatenate([there, back])
    force = np.asarray(pressed(law, PAIR, jnp.asarray(overlaps)))
    assert not force[: len(there)][there <= 0].any()
    cost = np.sum((force[1:] + force[:-1]) / 2 * np.diff(overlaps))
    expected = 0.5354 * (pull_off**5 / (MODULUS**2 * effective)) ** (1 / 3)
    assert cost == pytest.approx(expected, rel=1e-3)
    assert expected == pytest.approx(7.092 * (WORK**5 * effective**4 / MODULUS**2) ** (1 / 3), 1e-3)


def test_jkr_s_slopes_are_those_of_the_curve():
    """dF/dd = 2 E* a (s^3 - 3)/(s^3 - 1), down to the last overlap before it tears off."""
    effective, (_, gap) = RADIUS / 2, jkr_scales(RADIUS / 2)
    torn = np.sqrt(gap * effective / 3)

    def force(gamma, young, depth):
        path = jnp.stack([jnp.asarray(1e-3 * gap), depth])
        return drive_overlap(named("jkr", young=young, gamma=gamma), PAIR, path)[1]

    by_each = jax.jit(jax.jacfwd(force, (0, 1, 2)))
    for depth in np.array([5.0, 0.3, -0.5, -0.99, -1 + 1e-8]) * gap:
        root = np.roots([1, 0, 0, -4, -depth * effective / torn**2])
        s = root[np.isreal(root)].real.max()
        slope = 2 * MODULUS * torn * s * s * (s**3 - 3) / (s**3 - 1)
        gamma, young, overlap = (float(each) for each in by_each(GAMMA, YOUNG, jnp.asarray(depth)))
        assert overlap == pytest.approx(slope, rel=1e-5)
        # F/F_c depends on d over the gap alone, and F_c goes with w, the gap with (w/E)^(2/3).
        level = float(force(GAMMA, YOUNG, jnp.asarray(depth)))
        assert gamma * GAMMA == pytest.approx(level - 2 / 3 * depth * slope, rel=1e-4)
        assert young * YOUNG == pytest.approx(2 / 3 * depth * slope, rel=1e-4)
    beyond = by_each(GAMMA, YOUNG, jnp.asarray(-1.1 * gap))
    assert not np.any(beyond)


@pytest.mark.parametrize(
    ("friction_load", "expected"),
    [
        ("pull_off", lambda f, c, a: f + 2 * c),
        ("repulsive", lambda f, c, a: a),
        ("total", lambda f, c, a: -f),
    ],
)
def test_jkr_s_friction_feels_what_is_chosen(friction_load, expected):
    effective, (pull_off, _) = RADIUS / 2, jkr_scales(RADIUS / 2)
    law = named("jkr", gamma=GAMMA, friction_load=friction_load).normal
    force, _ = law.force(PAIR.contact(jnp.asarray(1e-9), jnp.asarray(0.0)), jnp.asarray(1.0))
    total = jkr_curve(1e-9, effective)
    repulsive = pull_off / 9 * 16  # s^3 = 4 where spheres just touch
    load = expected(total, pull_off, repulsive)
    assert float(force.frictional_load) == pytest.approx(load, rel=2e-3)
