"""A normal law whose friction feels the dashpot as well, with or without the adhesive share.

    N = |N_0 + f_damp|           adhesive: N_0 is the load of the law itself
    N = |f_hys + f_damp|         else

LIGGGHTS 3.8 limits friction by its whole normal force: `tan_luding` and `luding` add the adhesive
share, `history` and `epsd2` do not.  Contacts that adhesion holds together, f_n near 0, then
neither stick nor resist rolling with the latter: cohesive specimens hardly stand.
"""

import equinox as eqx

from jdem.core import smooth
from jdem.laws.base import AbstractNormalLaw
from jdem.mechanics.contact import Contact, NormalForce


class WholeLoad(AbstractNormalLaw):
    """The law `inner` in all but the load that friction feels."""

    inner: AbstractNormalLaw
    adhesive: bool = eqx.field(static=True, default=True)

    def force(self, contact: Contact, history):
        force, history = self.inner.force(contact, history)
        without_dashpot = force.frictional_load if self.adhesive else force.hysteretic
        load = smooth.absolute(without_dashpot + force.viscous, 0.0)
        return NormalForce(force.hysteretic, force.viscous, load), history

    def stiffness_bound(self, radius):
        return self.inner.stiffness_bound(radius)

    def damping_ratio(self):
        return self.inner.damping_ratio()

    def memory(self, shape, dtype):
        return self.inner.memory(shape, dtype)
