"""Exports of testing machines, made for tests: the committed ones, and small ones as text.

Curves are synthetic, in mm and N over s, with the generator that made the committed exports.
"""

import importlib.util

from calibrate.instrument_import.convert import read_export
from tests import DATA

EXPORTS = DATA / "machine_exports"
_spec = importlib.util.spec_from_file_location("make_exports", EXPORTS / "make_exports.py")
assert _spec is not None and _spec.loader is not None
curves = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(curves)

HEADING = ("Time (s)", "Extension (mm)", "Load (N)")
NAMES = {
    "English": ("Time (s)", "Extension (mm)", "Load (N)"),
    "German": ("Zeit [s]", "Weg in mm", "Prüfkraft [N]"),
    "Spanish": ("Tiempo (s)", "Desplazamiento (mm)", "Fuerza (N)"),
    "Chinese": ("时间(s)", "位移(mm)", "负荷(N)"),
    "French": ("Temps (s)", "Déplacement (mm)", "Force (N)"),
    "Italian": ("Tempo/s", "Spostamento/mm", "Forza/N"),
    "Portuguese": ("Tempo_s", "Deslocamento_mm", "Força_N"),
    "letters": ("t", "s [mm]", "F [N]"),
}


def columns(kind="confined", points=90, **choices):
    """A small synthetic curve as a dict of columns."""
    make = curves.confined if kind == "confined" else curves.crushing
    return dict(zip("txf", make(7, points=points, **choices), strict=True))


def text_of(curve, heading, delimiter=";", decimal=".", order="txf", before=(), scale=None):
    scale = scale or {}
    rows = [
        delimiter.join(f"{curve[c][i] * scale.get(c, 1):.6f}".replace(".", decimal) for c in order)
        for i in range(len(curve["f"]))
    ]
    return "\n".join([*before, delimiter.join(heading), *rows]) + "\n"


def written(folder, text, encoding="utf-8", name="export.csv"):
    (folder / name).write_bytes(text.encode(encoding))
    return folder / name


def only(path, **choices):
    (specimen,) = read_export(path, **choices).specimens
    return specimen
