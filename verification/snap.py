"""Why a derivative does not see a crushing force: a chain of spheres pulled apart.

Spheres in line are pressed between two platens and pulled apart again until one contact lets go.
Far from that moment the force does not know how strong the contact is.  The strength only sets when
it lets go; in a long chain the rest is so soft that this is a snap.  A pathwise derivative carries
it by growing through the snap; a derivative that is held back does not.

    python -m verification.snap                          some 4 minutes on two cores

Writes a section of verification/results/tangents.md.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jdem.core.vector import Vector
from jdem.engine.loop import AbstractDerivative, run, start
from jdem.engine.segment import cell_segment, stack
from jdem.engine.state import TangentDrag
from jdem.sensitivity.overdamped import Overdamped, OverdampedMotion
from tests.support.hand_made_beds import FAR, RADIUS, Smoothing, bed_of, soil_of, spheres_of
from verification import reporting

TRAVEL, SPEED, STEPS = 4e-3, 0.05, 10  # m, m/s
STEP = 0.2  # in ln of the surface energy
CHAINS = ((4, 2.0), (12, 5.0))  # spheres, exponent of the adhesive branch
HEADER = ("spheres", "tensile exponent", "largest tension (N)", "difference (mN)",
          "pathwise", "overdamped")  # fmt: skip


def pulled(count: int, exponent: float):
    """Platen's forces (N) while pulling, as a function of the shift in ln surface energy."""
    plain = {"plasticity_ratio": 0.5, "shear_modulus": 1e6, "restitution": 0.4}
    time_step = bed_of(spheres_of(count), soil_of(**plain), gravity=0.0).time_step
    z = RADIUS * (2 * jnp.arange(count) + 1.0)
    legs = stack(
        [
            cell_segment(platen_speed=v, duration=way / SPEED, damping=500.0)
            for v, way in ((SPEED, TRAVEL), (-SPEED, 2 * TRAVEL))
        ]
    )

    @eqx.filter_jit
    def force(shift, derivative: AbstractDerivative | None = None):
        adhesion = {"surface_energy": 60 * jnp.exp(shift), "wall_adhesion": 1.0}
        soil = soil_of(**plain, **adhesion, tensile_exponent=exponent)
        bed = bed_of(spheres_of(count), soil, gravity=0.0, smoothing=Smoothing())
        bed = eqx.tree_at(lambda b: b.time_step, bed, time_step)
        state = start(bed, Vector(0 * z, 0 * z, z), 2 * RADIUS * count, FAR)
        samples = run(bed, state, legs, jnp.asarray(STEPS), 4096, derivative=derivative).samples
        return jnp.where(samples.segment == 1, samples.platen_force, jnp.nan)

    return force


def measured(count: int, exponent: float) -> dict:
    """Mean slope (N per ln surface energy) while pulling, by differences and both derivatives."""
    force, given = pulled(count, exponent), Overdamped()
    drag = TangentDrag(given.background, given.contact)
    ways = {"pathwise": None, "overdamped": OverdampedMotion(drag, turning=())}
    up, down = (np.asarray(force(jnp.asarray(s))) for s in (STEP, -STEP))
    difference = float(np.nanmean(up - down) / (2 * STEP))
    slopes = {}
    for name, way in ways.items():
        _, slope = jax.jvp(lambda x, way=way: force(x, way), (jnp.zeros(()),), (jnp.ones(()),))
        slopes[name] = float(np.nansum(slope) / np.sum(np.isfinite(up)))
    tension = -float(np.nanmin(np.asarray(force(jnp.zeros(())))))
    return {"spheres": count, "exponent": exponent, "tension": tension,
            "difference": difference, **slopes}  # fmt: skip


def main() -> None:
    reporting.no_options(__doc__)
    reporting.configure()
    found = [measured(*chain) for chain in CHAINS]
    rows = [
        [
            str(each["spheres"]),
            f"{each['exponent']:g}",
            f"{each['tension']:.3f}",
            f"{1e3 * each['difference']:.2f}",
            *(f"{each[way] / each['difference']:.0%}" for way in ("pathwise", "overdamped")),
        ]
        for each in found
    ]
    origin = reporting.provenance()
    text = (
        "# A chain that is pulled apart\n\nMean over the pulling of d(force)/d ln(surface energy): "
        f"by differences over +-{STEP:g}, and the share of it that each derivative finds.\n\n"
        + reporting.table(HEADER, rows)
        + reporting.footer(origin)
    )
    reporting.write_section("tangents", text)


if __name__ == "__main__":
    main()
