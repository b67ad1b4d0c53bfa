"""Makes the machine exports of this folder from synthetic curves: `python make_exports.py`.

Curves are made up: a stiffening confined compression with unloading, a crushing with a peak,
each with an approach, a force that does not read zero before contact, and noise.  Headings
imitate what testing machines write; names, numbers and dates are invented.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from openpyxl import Workbook

HERE = Path(__file__).parent
APPROACH = 0.8  # mm before contact


def confined(seed, speed=0.5, at_400=6.2, exponent=2.2, points=320, noise=0.4):
    """Time (s), travel (mm), force (N): 400 N at `at_400` mm after contact, then unloading."""
    rng = np.random.default_rng(seed)
    top = APPROACH + at_400
    up = np.linspace(0, top, points)
    down = np.linspace(top, top - 0.9, points // 5)[1:]
    load = 400 * (np.maximum(up - APPROACH, 0) / at_400) ** exponent
    unload = 400 * np.maximum((down - (top - 0.7)) / 0.7, 0) ** 1.5
    travel, force = np.concatenate([up, down]), np.concatenate([load, unload])
    time = np.concatenate([[0], np.cumsum(np.abs(np.diff(travel)))]) / speed
    return time, travel, force + noise * rng.standard_normal(len(force))


def crushing(seed, speed=0.01, peak=206.0, at_peak=4.8, points=300, noise=0.5):
    """Time (s), travel (mm), force (N): a peak and softening, no unloading."""
    rng = np.random.default_rng(seed)
    travel = np.linspace(0, APPROACH + 2.4 * at_peak, points)
    share = np.maximum(travel - APPROACH, 0) / at_peak
    force = peak * share * np.exp(0.5 * (1 - share**2))
    return travel / speed, travel, force + noise * rng.standard_normal(points)


def decimal_comma():
    """German: semicolons, decimal comma, Windows-1252, a header block, tare of -1.7 N."""
    time, travel, force = crushing(1)
    block = [
        ("Prüfprotokoll", ""),
        ("Prüfnorm", "Einaxialer Druckversuch, unbehinderte Seitendehnung"),
        ("Prüfer", "Müller"),
        ("Datum", "12.03.2024"),
        ("Material", "schluffiger Lehm, Feld 3"),
        ("Probe Nr.", "SL-07"),
        ("Probendurchmesser d0", "50,0", "mm"),
        ("Probenhöhe h0", "100,0", "mm"),
        ("Probenmasse", "352,4", "g"),
        ("Prüfgeschwindigkeit", "0,6", "mm/min"),
        ("Kraftaufnehmer", "1 kN"),
        (),
        ("Prüfzeit", "Standardkraft", "Standardweg", "Traversenweg absolut"),
        ("s", "N", "mm", "mm"),
    ]
    rows = [
        (f"{t:.2f}", f"{f - 1.7:.3f}", f"{x:.4f}", f"{212.4 - x:.4f}")
        for t, x, f in zip(time, travel, force, strict=True)
    ]
    comma = [tuple(cell.replace(".", ",") for cell in row) for row in rows]
    text = "\r\n".join(";".join(row) for row in [*block, *comma])
    (HERE / "decimal_comma.csv").write_bytes((text + "\r\n").encode("cp1252"))


def tab_units():
    """Chinese: tabs, UTF-16, a row of units, kN, compression negative, confined."""
    time, travel, force = confined(2)
    lines = [
        "试验类型\t有侧限压缩试验",
        "试样编号: 3-1",
        "试样直径\t50\tmm",
        "试样高度\t100\tmm",
        "",
    ]
    lines += ["序号\t时间\t位移\t试验力", "\t(s)\t(mm)\t(kN)"]
    lines += [
        f"{i}\t{t:.3f}\t{x:.4f}\t{-f / 1000:.6f}"
        for i, (t, x, f) in enumerate(zip(time, travel, force, strict=True), start=1)
    ]
    (HERE / "tab_units.txt").write_bytes(("\r\n".join(lines) + "\r\n").encode("utf-16"))


def two_specimens():
    """English: a workbook with a sheet of results and one sheet for each of two specimens."""
    book = Workbook()
    summary = book.active
    summary.title = "Results"
    summary.append(["Specimen", "Fmax (N)", "Extension at Fmax (mm)"])
    curves = {"A-1": confined(3, at_400=5.9), "A-2": confined(4, at_400=6.6)}
    for name, (_, travel, force) in curves.items():
        summary.append([name, float(force.max()), float(travel[np.argmax(force)])])
    for name, columns in curves.items():
        page = book.create_sheet(f"Specimen {name}")
        page.append(["Specimen ID", name])
        page.append(["Diameter", 50, "mm"])
        page.append(["Height", 100, "mm"])
        page.append(["Test speed", 0.5, "mm/s"])
        page.append([])
        page.append(["Extension (mm)", "Load (N)", "Time (s)"])
        for t, x, f in zip(*columns, strict=True):
            page.append([round(float(x), 5), round(float(f), 3), round(float(t), 4)])
    book.save(HERE / "two_specimens.xlsx")


def trouble():
    """English: four specimens below each other; one clipped, one with a gap, one in kN."""
    clipped = np.array(crushing(5, points=200))
    clipped[2] = np.minimum(clipped[2], 150.0)
    gap = np.delete(np.array(confined(6, points=160)), slice(88, 104), axis=1)
    kilonewtons = np.array(confined(7, points=160)) * [[1], [1], [-1e-3]]
    good = np.array(crushing(8, peak=230.0, at_peak=3.8, points=160))
    lines = []
    for name, columns in {
        "clipped": clipped,
        "with gap": gap,
        "kN as N": kilonewtons,
        "good": good,
    }.items():
        lines += [f"Specimen: {name}", "Time (s);Extension (mm);Load (N)"]
        lines += [f"{t:.3f};{x:.4f};{f:.6f}" for t, x, f in columns.T]
    (HERE / "trouble.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def hopeless():
    """A report with results only: nothing to fit a curve to."""
    text = """Unconfined compression, summary report
Operator: K. Jensen
Specimen;Fmax (N);Extension at Fmax (mm);Remark
A-1;206.1;4.81;ok
A-2;214.9;4.66;ok
A-3;198.4;5.02;edge broken
Mean;206.5;4.83;
Std. dev.;8.3;0.18;
"""
    (HERE / "hopeless_report.txt").write_text(text, encoding="utf-8")


def stress_strain():
    """A crushing as strain (%) and stress (kPa) of 50 mm by 100 mm, which the file conceals."""
    _, travel, force = crushing(9, points=150)
    area = np.pi / 4 * 50.0**2
    rows = [f"{x:.4f};{1e3 * f / area:.4f}" for x, f in zip(travel, force, strict=True)]
    text = "\n".join(["Axial strain (%);Stress (kPa)", *(r.replace(".", ",") for r in rows)])
    (HERE / "stress_strain.csv").write_text(text + "\n", encoding="utf-8")


def load_steps():
    """German: an oedometer test with unloading and reloading, 70 mm by 20 mm, e0 = 0.912."""
    stresses = [12.5, 25, 50, 100, 200, 100, 25, 100, 200, 400]
    virgin, swelling = 0.25, 0.04  # slopes over log10 of stress
    ratio, highest, rows = 0.912, 12.5, []
    for number, (before, stress) in enumerate(pairwise([10.0, *stresses]), start=1):
        elastic = min(stress, max(highest, before)) / before
        ratio -= swelling * np.log10(elastic) + virgin * np.log10(max(stress / highest, 1.0))
        highest = max(highest, stress)
        rows.append(f"{number};{1440 * number};{stress:g};{ratio:.4f}".replace(".", ","))
    head = """Ödometerversuch
Probe Nr.;Lehm 3
Probendurchmesser;70,0;mm
Probenhöhe;20,0;mm
Anfangsporenzahl e0;0,912

Laststufe;Zeit (min);Spannung (kN/m²);Porenzahl e (-)
"""
    (HERE / "load_steps.csv").write_text(head + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    texts = (decimal_comma, tab_units, trouble, hopeless, stress_strain, load_steps)
    for make in (*texts, two_specimens):
        make()
