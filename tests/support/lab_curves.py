"""Random files of laboratory curves whose right numbers are known.

A file has one to three specimens of one test, in any units, languages, headings, order of columns,
delimiters, with lines before the table, headings repeated, and further columns beside.
"""

from dataclasses import dataclass, field

import numpy as np

AREA = np.pi / 4 * 0.05**2  # m2, of 50 mm
HEIGHT = 100.0  # mm
G = 9.80665

# How a unit is written -> its size in N, mm, s, kPa, a fraction, from its definition.
FORCE = {
    "N": 1, "kN": 1e3, "KN": 1e3, "daN": 10, "MN": 1e6, "mN": 1e-3, "kgf": G, "kp": G,
    "gf": G / 1e3,
    "kg": G, "Kg": G, "kgs": G, "g": G / 1e3, "gm": G / 1e3, "t": 1e3 * G, "tonnes": 1e3 * G,
    "tf": 1e3 * G,
    "lbf": 4.4482216152605, "lb": 4.4482216152605, "lbs": 4.4482216152605, "LBF": 4.4482216152605,
    "pounds": 4.4482216152605, "kip": 4448.2216152605, "kips": 4448.2216152605, "dyn": 1e-5,
    "oz": 0.27801385095378, "ozf": 0.27801385095378, "newton": 1, "Newtons": 1, "kilonewton": 1e3,
    "pound_force": 4.4482216152605, "kilogram_force": G, "poundal": 0.138254954376, "x10 N": 10,
}  # fmt: skip
LENGTH = {
    "mm": 1, "MM": 1, "cm": 10, "m": 1e3, "dm": 100, "um": 1e-3, "µm": 1e-3, "in": 25.4,
    "inch": 25.4,
    "inches": 25.4, "ft": 304.8, "feet": 304.8, "mil": 0.0254, "mils": 0.0254, "thou": 0.0254,
    "millimeters": 1, "micron": 1e-3, "0.01 mm": 0.01, "0.001 in": 0.0254, "10^-2 mm": 0.01,
    "yd": 914.4,
    "1/100 mm": 0.01, "milímetros": 1, "pulgadas": 25.4, "Zoll": 25.4,
}  # fmt: skip
STRESS = {
    "Pa": 1e-3, "kPa": 1, "KPa": 1, "MPa": 1e3, "Mpa": 1e3, "GPa": 1e6, "hPa": 0.1, "bar": 100,
    "mbar": 0.1,
    "psi": 6.894757293168, "ksi": 6894.757293168, "psf": 0.04788025898, "ksf": 47.88025898,
    "tsf": 95.76051796, "N/mm2": 1e3, "N/mm²": 1e3, "N/cm2": 10, "kN/m2": 1, "kN/m^2": 1,
    "N/m2": 1e-3,
    "kg/cm2": 98.0665, "kgf/cm²": 98.0665, "kg/m2": 9.80665e-3, "t/m2": 9.80665,
    "g/cm2": 9.80665e-2,
    "lb/ft2": 0.04788025898, "lbs/in2": 6.894757293168, "lbf/ft^2": 0.04788025898, "atm": 101.325,
    "kp/cm2": 98.0665, "kilopascal": 1, "kN m-2": 1, "lb per sq in": 6.894757293168, "MN/m2": 1e3,
    "torr": 0.13332236842, "psig": None,
}  # fmt: skip
STRAIN = {
    "%": 0.01, "pct": 0.01, "percent": 0.01, "-": 1, "mm/mm": 1, "in/in": 1, "m/m": 1, "‰": 1e-3,
    "permille": 1e-3, "microstrain": 1e-6, "µε": None, "mm/m": 1e-3, "Prozent": 0.01,
}  # fmt: skip
TIME = {
    "s": 1, "sec": 1, "secs": 1, "seconds": 1, "min": 60, "minutes": 60, "h": 3600, "hr": 3600,
    "hours": 3600,
    "ms": 1e-3, "d": 86400, "days": 86400, "Sekunden": 1, "minutos": 60, "秒": 1, "heures": 3600,
}  # fmt: skip
UNITS = {"force": FORCE, "displacement": LENGTH, "stress": STRESS, "strain": STRAIN, "time": TIME}
KNOWN = {k: {u: f for u, f in units.items() if f} for k, units in UNITS.items()}

NAMES = {
    "force": (
        *("Load", "Axial Load", "Force", "Kraft", "Prüfkraft", "Carga axial", "Fuerza", "Charge"),
        *("Forza", "Força", "载荷", "ram load", "Standard force"),
    ),
    "displacement": (
        *(
            "Displacement",
            "Axial Displacement",
            "Extension",
            "Weg",
            "Desplazamiento",
            "Déplacement",
        ),
        *("Spostamento", "Deslocamento", "位移", "platen travel", "Crosshead", "Stroke"),
    ),
    "stress": ("Stress", "Axial Stress", "Spannung", "Esfuerzo", "Contrainte", "应力", "Pressure"),
    "strain": ("Strain", "Axial Strain", "Deformación unitaria", "axial strain", "应变"),
    "time": ("Time", "Zeit", "Tiempo", "Temps", "Tempo", "时间", "Elapsed Time", "test time"),
}
OTHERS = ("Temperature (°C)", "Cycle", "Extension rate (mm/min)", "Energy (J)", "Peak load (N)")
NUMBERS = ("Specimen", "Sample ID", "replicate", "RepeatID", "Run", "Test No.", "specimen_id")
DELIMITERS = (";", "\t", ",", "|")


@dataclass
class MadeFile:
    """The text of a file, the test, and travel (mm) and force (N) of each specimen; `points`
    (specimens,) are their numbers of rows."""

    text: str
    test: str
    travel: list[np.ndarray]
    force: list[np.ndarray]
    choices: list[str] = field(default_factory=list)


def snake(name: str, unit: str) -> str:
    joined = f"{name} {unit}".replace("/", " ").replace("^", "").replace("²", "2")
    return "_".join(joined.lower().split() if unit.lower() != "mn" else joined.split())


def camel(name: str, unit: str) -> str:
    """ "axialLoadKN"; a unit that a capital would change stays apart."""
    if unit[0] in "µ(-1" or unit == "mN":
        return f"{name} ({unit})"
    first, *rest = name.split()
    return first.lower() + "".join(w.capitalize() for w in rest) + unit[:1].upper() + unit[1:]


PLACES = {
    "round": lambda name, unit: f"{name} ({unit})",
    "square": lambda name, unit: f"{name} [{unit}]",
    "close": lambda name, unit: f"{name}({unit})",
    "stop": lambda name, unit: f"{name} ({unit}.)",
    "blank": lambda name, unit: f"{name} {unit}",
    "comma": lambda name, unit: f"{name}, {unit}",
    "in": lambda name, unit: f"{name} in {unit}",
    "snake": snake,
    "camel": camel,
    "under": lambda name, unit: f"{name.replace(' ', '_')}_{unit}",
}


def one_curve(rng: np.random.Generator, test: str) -> tuple[np.ndarray, np.ndarray]:
    """Travel (mm) and force (N) of a curve that rises from nought and softens or stiffens."""
    count = int(rng.integers(30, 90))
    if test == "unconfined":
        reach, peak = rng.uniform(8, 14), rng.uniform(60, 400)
        travel = np.linspace(0, reach, count)
        u = travel / rng.uniform(3.5, 5)
        return travel, peak * u * np.exp(1 - u)
    reach, top = rng.uniform(4, 8), rng.uniform(300, 800)
    travel = np.linspace(0, reach, count)
    return travel, top * (travel / reach) ** rng.uniform(1.8, 2.6)


def made_file(rng: np.random.Generator) -> MadeFile:
    """A random admissible file."""
    test = str(rng.choice(["unconfined", "confined"]))
    many = int(rng.choice([1, 1, 1, 2, 3]))
    curves = [one_curve(rng, test) for _ in range(many)]
    kinds = [str(rng.choice(["displacement", "strain"])), str(rng.choice(["force", "stress"]))]
    kinds += ["time"] if rng.random() < 0.6 else []
    rng.shuffle(kinds)
    delimiter = str(rng.choice(DELIMITERS))
    decimal = "," if delimiter != "," and rng.random() < 0.4 else "."
    units_below = rng.random() < 0.2
    written = {kind: _written(rng, kind, delimiter, units_below) for kind in kinds}
    how = str(rng.choice(["number", "none", "headed"])) if many > 1 else "one"
    columns = [*kinds, *(["other"] if rng.random() < 0.3 else [])]
    columns = [*(["number"] if how == "number" else []), *columns]
    other, number = str(rng.choice(OTHERS)), str(rng.choice(NUMBERS))
    heads = {"other": other, "number": number} | {k: w[0] for k, w in written.items()}
    lines = [delimiter.join(heads[c].replace(delimiter, " ") for c in columns)]
    if units_below:
        lines.append(delimiter.join(written[c][1] if c in written else "" for c in columns))
    head, page = list(lines), int(rng.integers(15, 40)) if rng.random() < 0.2 else 0
    body: list[str] = []
    for place, (travel, force) in enumerate(curves):
        body += head if how == "headed" and place else []
        for row in range(len(travel)):
            if page and row and row % page == 0:
                body += head
            cells = {
                "number": str(place + 1),
                "other": f"{rng.uniform(19, 21):.2f}",
                "displacement": travel[row],
                "strain": travel[row] / HEIGHT,
                "force": force[row],
                "stress": force[row] / AREA / 1e3,
                "time": 2.0 * row,
            }
            body.append(delimiter.join(_cell(cells[c], written.get(c), decimal) for c in columns))
    comment = "# " if rng.random() < 0.1 and not (page or how == "headed" or units_below) else ""
    above = _preamble(rng, delimiter)
    lines = [comment + line for line in lines]
    text = "\n".join([*above, *lines, *body]) + "\n"
    choices = [how, f"page {page}", delimiter, decimal, *lines[:2]]
    return MadeFile(text, test, [c[0] for c in curves], [c[1] for c in curves], choices)


def _written(rng, kind: str, delimiter: str, below: bool) -> tuple[str, str, float]:
    """Heading, unit and its size."""
    name = str(rng.choice(NAMES[kind]))
    unit = str(rng.choice([u for u in KNOWN[kind] if delimiter not in u]))
    places = [p for p in PLACES if p != "comma" or delimiter != ","]
    place = str(rng.choice(places))
    return (name if below else PLACES[place](name, unit)), unit, KNOWN[kind][unit]


def _cell(value: float | str, written: tuple[str, str, float] | None, decimal: str) -> str:
    if isinstance(value, str):
        return value.replace(".", decimal)
    assert written is not None
    return f"{value / written[2]:.10g}".replace(".", decimal)


def _preamble(rng, delimiter: str) -> list[str]:
    lines = [f"Operator{delimiter}A. B.", f"Date{delimiter}2024-03-12", "Machine: frame 3", ""]
    return lines if rng.random() < 0.4 else []
