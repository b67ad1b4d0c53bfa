"""Keys of beds and runs change with the source that their numbers depend on, and with no other.

On copies of `jdem`, then on objects of a laboratory.
"""

import shutil
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from toy_place import SPECIMEN, soils, toy_campaign

import jdem
from calibrate.simulation import keys
from calibrate.simulation.definitions import Sources
from calibrate.simulation.dependencies import Dependencies
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.effects.composite import EFFECTS
from jdem.engine.bed import Numerics
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab

ROOTS = {
    "prepare": [("jdem.packing.composite", "prepare")],
    "run": [("jdem.laboratory.virtual_lab", "VirtualLab")],
    "cemented": [
        ("jdem.laboratory.virtual_lab", "VirtualLab"),
        ("jdem.effects.cementation", "Cementation"),
    ],
}


@pytest.fixture
def copy(tmp_path):
    """A copy of `jdem` that may be edited."""
    source = Path(jdem.__path__[0])
    shutil.copytree(source, tmp_path / "jdem", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "jdem"


def hashes(folder: Path) -> dict[str, str]:
    found = Dependencies(Sources({"jdem": folder}))
    return {name: found.hash_of(roots) for name, roots in ROOTS.items()}


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_comments_and_docstrings_of_the_simulator_change_nothing(copy):
    before = hashes(copy)
    for path in copy.rglob("*.py"):
        text = path.read_text(encoding="utf-8").replace('"""', '"""Again: ', 1)
        path.write_text(f"# a comment\n{text}\n# and another\n", encoding="utf-8")
    assert hashes(copy) == before


def test_a_constant_of_a_law_changes_beds_and_runs(copy):
    before = hashes(copy)
    replaced(copy / "laws" / "eepa.py", "_RATIO_FLOOR = 1e-3", "_RATIO_FLOOR = 2e-3")
    after = hashes(copy)
    assert all(after[name] != before[name] for name in before)


def test_a_test_of_the_laboratory_changes_runs_and_no_bed(copy):
    before = hashes(copy)
    replaced(copy / "observables.py", "jnp.", "np.")
    after = hashes(copy)
    assert after["prepare"] == before["prepare"]
    assert after["run"] != before["run"]


def test_a_new_effect_changes_nothing_of_runs_without_it(copy):
    before = hashes(copy)
    effects = copy / "effects"
    text = (effects / "gain.py").read_text(encoding="utf-8")
    (effects / "warmth.py").write_text(text.replace("LoadCellGain", "Warmth"), encoding="utf-8")
    known = '    "load_cell_gain": LoadCellGain,\n'
    replaced(effects / "composite.py", known, known + '    "warmth": Warmth,\n')
    line = "from jdem.effects.gain import LoadCellGain\n"
    replaced(effects / "composite.py", line, line + line.replace("gain", "warmth", 1))
    assert hashes(copy) == before


def test_an_effect_changes_runs_with_it_alone(copy):
    before = hashes(copy)
    replaced(copy / "effects" / "cementation.py", "return ", "return 2 * ")
    after = hashes(copy)
    assert {name for name in before if after[name] != before[name]} == {"cemented"}


def test_what_an_effect_says_about_itself_changes_nothing(copy):
    before = hashes(copy)
    replaced(copy / "effects" / "cementation.py", 'source="', 'source="see also ')
    assert hashes(copy) == before


def test_how_responses_are_differentiated_is_not_part_of_a_run():
    found = keys._dependencies(frozenset())
    modules = {one.module for roots in ROOTS.values() for one in found.reached(roots)}
    assert not [name for name in modules if name.startswith(("jdem.sensitivity", "calibrate"))]
    assert "jdem.laws.eepa" in modules and "jdem.effects.cementation" in modules


# ------------------------------------------------------------------ keys


def test_what_is_inside_a_laboratory_counts():
    first, second = ConfinedCompression(), UnconfinedCompression()

    def lab(*effects, tests=(first,)):
        return VirtualLab.of(SPECIMEN, TestSequence(tests), Numerics(), effects)

    effects = [EFFECTS[name](0.0) for name in ("cementation", "rate_dependence")]
    found = [keys.source_hash(lab(*chosen)) for chosen in ([], effects[:1], effects[1:], effects)]
    found.append(keys.source_hash(lab(tests=(first, second))))
    assert len(set(found)) == 5
    assert keys.engine_hash(lab()) != keys.engine_hash() == keys.engine_hash(soils(1)[0])
    assert keys.engine_hash(Mine) == keys.engine_hash()  # it travels with the objects


class Mine:
    """A class outside of both packages."""


def test_objects_of_all_kinds_are_looked_into():
    def names(root):
        return {keys._name(one)[1] for one in keys._definitions(root)}

    assert names({"a": [Mine, (1.0, "b")]}) == {"Mine"}
    assert names(partial(names, SPECIMEN)) >= {"Specimen"}
    assert names(np.sin) == {"sin"}
    assert names((None, 1, np.ones(3))) == set()
    assert keys.source_hash(Mine) != keys.source_hash(np.sin) != keys.source_hash(np.cos)


def test_keys_of_runs_differ_by_soil_and_packing(tmp_path):
    work = toy_campaign(tmp_path)
    assert len({work.key(soil, seed) for soil in soils(2) for seed in (0, 1)}) == 4


def test_a_key_depends_on_the_source_of_the_run_and_of_the_bed(tmp_path, monkeypatch):
    """Each under a name of its own, or one would stand in the place of the other."""
    work, (soil,) = toy_campaign(tmp_path), soils(1)
    found = {work.key(soil, 0)}
    for part in ("RUNS", "SETTLES"):
        with monkeypatch.context() as patch:
            patch.setattr(keys, part, (Mine,))
            found.add(work.key(soil, 0))
    assert len(found) == 3


def test_keys_are_made_by_several_threads_at_once():
    """Every source is parsed anew; Python 3.11 cannot parse in two threads at a time."""
    expected = keys.packing_content(SPECIMEN, 0, None)
    for cached in (keys._source_hash, keys._dependencies):
        cached.cache_clear()
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: keys.packing_content(SPECIMEN, 0, None), range(16)))
    assert made == [expected] * 16
