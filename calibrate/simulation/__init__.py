"""Many simulations: cached on disk by content, resumable, on these cores or on a cluster.

keys.py        what a bed or a run depends on, hashed: its name on disk
run.py         one finished simulation in mm and N, with the checks that say whether to trust it
compiled.py    simulating and preparing, with programs compiled once a process
seal.py store.py   entries of the cache: atomic, with checksum, one writer at a time
executors.py batches.py cluster.py   where the work is done: threads here, an accelerator, a cluster
campaign.py    from soils and seeds to runs: what is missing is simulated, what fails is labelled
"""

from calibrate.simulation.campaign import Campaign
from calibrate.simulation.compiled import blank
from calibrate.simulation.executors import HERE, AbstractPlace, Here, cores, side_by_side
from calibrate.simulation.run import Run, not_simulated, summary
from calibrate.simulation.store import NETCDF

__all__ = [
    "HERE",
    "NETCDF",
    "AbstractPlace",
    "Campaign",
    "Here",
    "Run",
    "blank",
    "cores",
    "not_simulated",
    "side_by_side",
    "summary",
]
