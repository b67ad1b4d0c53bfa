"""The same campaign on a real Dask cluster of processes, one of which is killed in the middle."""

import gc
import os
import signal
import threading
import time

import equinox as eqx
import jax
import numpy as np
import pytest
from distributed import Client, LocalCluster, get_worker

from calibrate import cli
from calibrate.core.errors import CalibrationError, InputError
from calibrate.io.soil import with_values
from calibrate.simulation import cluster as cluster_module
from calibrate.simulation import keys
from calibrate.simulation.cluster import DaskCluster, code_of, on_worker
from jdem.effects.composite import EFFECTS
from tests.support.formulas import BASE, tiny_campaign
from tests.support.toy_place import soils, toy_campaign

pytestmark = pytest.mark.thorough

SEEDS = (0, 1)
ENERGIES = (10.0, 12.0, 14.0, 16.0)


@pytest.fixture(scope="module")
def dask():
    """Two workers in processes of their own, which a nanny starts again when they die."""
    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True}
    with LocalCluster(**settings, dashboard_address=None, host="127.0.0.1") as running:
        yield running


@pytest.fixture
def place(dask):
    there = DaskCluster(dask.scheduler_address)
    yield there
    there.close()


def curves(rows):
    return [[(run.observables, run.curves["confined"].tolist()) for run in row] for row in rows]


def kill_one_worker_after(folder, finished, dask, killed):
    """SIGKILL to a worker's process once so many runs are on disk."""
    while len(list((folder / "runs").glob("*.nc"))) < finished:
        time.sleep(0.02)
    victim = next(iter(dask.workers.values()))
    killed.append(victim.pid)
    os.kill(victim.pid, signal.SIGKILL)


@pytest.mark.slow
def test_a_campaign_survives_the_death_of_a_worker(dask, place, tmp_path):
    """Packings and runs of 48 spheres: every one comes back, equal to those simulated here."""
    tested = [with_values(BASE, {"surface_energy": energy}) for energy in ENERGIES]
    work = tiny_campaign(tmp_path / "there")
    work.place = place
    killed = []
    watcher = threading.Thread(
        target=kill_one_worker_after, args=(work.folder, 2, dask, killed), daemon=True
    )
    watcher.start()
    rows = work.runs(tested, SEEDS, "on the cluster")
    watcher.join()
    assert killed
    assert work.simulated == len(ENERGIES) * len(SEEDS)
    assert not any(run.failure for row in rows for run in row)
    here = tiny_campaign(tmp_path / "here")
    assert curves(here.runs(tested[:1], SEEDS, "here")) == curves(rows[:1])
    again = tiny_campaign(work.folder)
    assert curves(again.runs(tested, SEEDS, "stored")) == curves(rows)
    assert again.simulated == 0


@pytest.mark.slow
def test_a_run_that_kills_every_worker_is_a_labelled_row(dask, place, tmp_path, monkeypatch):
    """A row; whatever is asked for afterwards is simulated all the same.

    (What waits at the worker that dies is counted by Dask as if it had done it, and is why runs
    are handed in again.)
    """
    monkeypatch.setattr(cluster_module, "simulated", deadly)
    work = toy_campaign(tmp_path)
    prepare = work.place.prepare
    work.place = place
    monkeypatch.setattr(DaskCluster, "prepare", lambda self, *arguments: prepare(*arguments))
    monkeypatch.setattr("calibrate.simulation.campaign.TRIES", 1)
    monkeypatch.setattr(dask.scheduler, "allowed_failures", 0)
    first, second = (work.runs([soil], (0,), "deadly")[0][0] for soil in soils(2))
    assert first.failure.startswith("not simulated, tried 1 times: workers died with it")
    assert second.failure == "the other one"


def deadly(lab, specimen, packing, soil):
    """Kills its worker at once for one soil; labels the other."""
    from calibrate.simulation.run import not_simulated

    if float(soil.surface_energy) < 10.5:
        assert get_worker()
        os.kill(os.getpid(), signal.SIGKILL)
    return not_simulated(lab, "the other one")


class MyDrift(eqx.Module):
    """An effect in a file of one's own."""

    strength: float = 0.0


def test_a_worker_with_other_code_is_refused(monkeypatch):
    for drift in (EFFECTS["load_cell_drift"](0.0), MyDrift()):
        code = code_of((drift,))
        assert on_worker(type, code, {}, (drift,)) is type(drift)
        with monkeypatch.context() as later:
            later.setattr(cluster_module, "PHYSICS", cluster_module.PHYSICS + 1)
            with pytest.raises(CalibrationError, match="physics 1, physics 2"):
                on_worker(type, code, {}, (drift,))
    monkeypatch.setattr(keys, "_text_hash", lambda module: "other text")
    with pytest.raises(CalibrationError, match="MyDrift other text"):
        on_worker(type, code, {}, (drift,))


@pytest.mark.slow
def test_numbers_keep_their_precision_on_the_way(place):
    value = jax.numpy.asarray(np.pi)
    assert place._computed(np.negative, value).dtype == np.float64
    assert float(place._computed(np.negative, value)) == -np.pi


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1:9", "ftp://x:1", ""])
def test_an_address_without_scheduler_is_refused(address, monkeypatch):
    monkeypatch.setattr(cluster_module, "PATIENCE", 1.0)
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        DaskCluster(address)


@pytest.mark.slow
def test_a_refused_address_leaves_no_client_behind():
    """One that did would be closed by the thread of the next client, which waits for it."""
    before = clients()  # held, so that none of these goes meanwhile
    with pytest.raises(InputError) as kept:
        DaskCluster("nonsense")
    left = [each for each in clients() if not any(each is one for one in before)]
    assert not left, kept


def clients() -> list[Client]:
    return [each for each in gc.get_objects() if type(each) is Client]


@pytest.mark.parametrize("verb", ["simulate", "fit", "audit", "doe"])
def test_verbs_that_simulate_many_take_an_address(verb, monkeypatch, tmp_path, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster_module, "PATIENCE", 1.0)
    monkeypatch.setattr(cli, "_configure", lambda: None)
    monkeypatch.setattr("sys.argv", ["calibrate", verb, "--dask", "tcp://127.0.0.1:9"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    error = capfd.readouterr().err.splitlines()
    assert len(error) == 1 and "--dask" in error[0]


def test_a_lost_scheduler_is_one_sentence(tmp_path):
    """Started after the others: it takes the scheduler away from under the campaign."""
    running = LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None
    )
    there = DaskCluster(running.scheduler_address)
    threading.Timer(0.5, running.close).start()
    with pytest.raises(CalibrationError, match="lost the Dask scheduler"):
        there._computed(time.sleep, 4)
