"""Sentences with measured numbers, what makes their numbers, and when they hold.

`verification.__main__` makes them again with `verification.scripts`, `verification.quick` repeats
smaller forms."""

import re
from collections.abc import Callable, Mapping, Sequence

from verification.reporting import NUMBER, Cell, Numbers, Row, only

README, SURE = "README.md", "docs/howto/how-sure.md"


def _largest(found: list[float]) -> float:
    return max(found, key=abs)


def _size(found: list[float]) -> float:
    return max(map(abs, found))


def _within(limits: Mapping[str, float]) -> Callable[[Numbers], bool]:
    """Each number's size is at most its limit."""
    return lambda numbers: all(abs(numbers[name]) <= limit for name, limit in limits.items())


def _small(names: Sequence[tuple[str, str]], floor: float) -> Callable[[Numbers], bool]:
    """Each difference lies within three of its standard errors, or within `floor`."""
    return lambda n: all(abs(n[d]) <= max(3 * n[e], floor) for d, e in names)


CRUSHED = "unconfined"
PUBLISHED = "at most the publication's errors, 2.8 and 3.7 %, the force with a standard error more"


def _as_published(n: Numbers) -> bool:
    return 0 <= n["depth"] <= 2.8 and 0 <= n["force"] <= 3.7 + min(n["error"], 3.0)


WHEAT, TRUMAO = {"soil": "wheat_after_rice"}, {"soil": "trumao"}
DEPTH, FORCE = {"observable": "depression depth (mm)"}, {"observable": "crushing force (N)"}
STUDIES = "studies"


def _fresh(of: dict, seed: int, soil: dict = WHEAT) -> Cell:
    return Cell("fresh_packings", "error", {**soil, "seed": str(seed), **of})


def _fresh_error(soil: dict, how=only) -> Cell:
    column = "fresh packings: mean ± s.e."
    return Cell("fresh_packings", column, {**soil, **FORCE}, 1, how, over="measured")


def _codes(of: str, how=_size, part: int = 0, **where: str) -> Cell:
    return Cell("codes", "LIGGGHTS over ours", {"observable": of, **where}, part, how, STUDIES)


def _level(column: str, part: int = 0) -> Cell:
    where = {"both tests": "LIGGGHTS' conventions", "LIGGGHTS": "sorting off"}
    return Cell("codes", column, where, part, _size, STUDIES)


def _diagnosis(question: str, part: int = 0, column: str = "found") -> Cell:
    where = {"question": question, "of which cases": "sealed"}
    return Cell("diagnosis", column, where, part, folder=STUDIES)


def _slope(of: str, parameter: str | re.Pattern, how=_largest) -> Cell:
    sets = {"under": re.compile(".*[Aa]s fits take them"), "after": re.compile("Packings of seed")}
    return Cell("audit", "differs by", {**sets, "of": of, "parameter": parameter}, how=how)


def _hidden(line: str, part: int = 0) -> Cell:
    return Cell("posterior", line=line, part=part)


def _curve(test: str, part: int = 0, column: str = "error") -> Cell:
    return Cell("fresh_packings", column, {"test": test}, part)


def _variant(variant: str, column: str, part: int = 0) -> Cell:
    return Cell("convergence", column, {"variant": variant}, part)


def _bed(spheres: int, column: str, part: int = 0) -> Cell:
    return Cell("resolution", column, {"beds": "usual porosity", "spheres": str(spheres)}, part)


def _sizes(of: dict, beds: str, soil: dict, how=_largest, column: str = "error") -> Cell:
    return Cell("sizes", column, {**soil, "beds": beds, **of}, how=how)


def _again(name: str, column: str, part: int = 0) -> Cell:
    where = {"spheres": "500", "observable": name}
    return Cell("resolution", column, where, part)


def _calibration(start: str, way: str) -> Cell:
    return Cell("designs", way, {"start": start})


STRONG, WEAK = "one effect above 6: named first", "one effect 2 to 6: named first"
UNKNOWN = "effects that the library lacks, above 2: called unknown"
SOUND = "nothing hidden: something named"
FAINT, BOTH = "one effect below 2: named first", "two effects: both named"
VARIANTS = {"r": "both rates halved", "s": "time step halved", "d": "background damping halved",
            "o": "all roundings sharp"}  # fmt: skip
STARTS = ("base soil", "stiff, weak", "soft, strong")

ROWS = (
    Row(
        "fresh packings", README,
        ("Three fits of the bundled soil met its depression depth within {depth:.1f} % and its "
         "crushing force within {force:.1f} %, each on twelve fresh packings",),
        "fresh_packings",
        {"error": _fresh_error(WHEAT, max),
         **{name: Cell("fresh_packings", "error", {**WHEAT, **of}, how=_size)
            for name, of in (("depth", DEPTH), ("force", FORCE))}},
        PUBLISHED, _as_published,
    ),
    Row(
        "whole curves", README,
        ("the confined curve was {depth:.1f} % off and the unconfined one {force:.1f} ± "
         "{error:.1f} %",),
        "whole_curves",
        {"depth": _curve("confined"), "force": _curve(CRUSHED), "error": _curve(CRUSHED, 1)},
        PUBLISHED, _as_published,
    ),
    Row(
        "codes", README,
        ("gave our depression depth within {depth:.1f} % and our crushing force within "
         "{force:.1f} %",),
        "codes", {"depth": _codes("H (mm)"), "force": _codes("F (N)")},
        "at most 1 and 5 %", _within({"depth": 1.0, "force": 5.0}),
    ),
    Row(
        "diagnosis", README,
        ("It named {a:.0f} of {b:.0f} strong causes (above six times the noise), {c:.0f} of "
         "{d:.0f} weak ones (two to six times) and {i:.0f} of {j:.0f} fainter ones",
         "It called {e:.0f} of {f:.0f} causes that it does not know \"unknown\"",
         "named both of two causes in {k:.0f} of {l:.0f} cases",
         "accused {g:.0f} of {h:.0f} cases in which nothing was hidden"),
        "diagnosis",
        {
            **{name: _diagnosis(question, part) for (name, part), question in zip(
                [(c, k % 2) for k, c in enumerate("abcdefghijkl")],
                [q for q in (STRONG, WEAK, UNKNOWN, SOUND, FAINT, BOTH) for _ in range(2)],
                strict=True)},
            **{name: _diagnosis(question, part, "95 % interval") for name, question, part in (
                ("strong", STRONG, 1), ("weak", WEAK, 1), ("unknown", UNKNOWN, 1),
                ("sound", SOUND, 0))},
        },
        "the 95 % intervals of the shares reach 90, 60 and 70 %, and begin at most at 5 %",
        lambda n: (n["strong"] >= 90 and n["weak"] >= 60 and n["unknown"] >= 70
                   and n["sound"] <= 5),
        "its library is older",
    ),
    Row(
        "fresh packings, one by one", SURE,
        ("They missed the measured depth by {h0:+.1f}, {h1:+.1f} and {h2:+.1f} %, and the force by "
         "{f0:+.1f}, {f1:+.1f} and {f2:+.1f} %. The standard error of the force is {low:.1f} to "
         "{high:.1f} %",
         "A fit of a second soil, trumao, missed by {h3:+.1f} % and {f3:+.1f} % (standard error "
         "{f3e:.1f} %)"),
        "fresh_packings",
        {
            **{f"h{seed}": _fresh(DEPTH, seed) for seed in range(3)},
            **{f"f{seed}": _fresh(FORCE, seed) for seed in range(3)},
            "h3": _fresh(DEPTH, 0, TRUMAO), "f3": _fresh(FORCE, 0, TRUMAO),
            "low": _fresh_error(WHEAT, min), "high": _fresh_error(WHEAT, max),
            "f3e": _fresh_error(TRUMAO),
        },
        "depth within 2.8 %, force within 5 %, some three standard errors",
        _within({f"{of}{k}": limit for of, limit in (("h", 2.8), ("f", 5.0)) for k in range(4)}),
    ),
    Row(
        "R² of whole curves", SURE,
        ("R² is {confined:.1f} % of the confined and {unconfined:.1f} % of the unconfined curve",),
        "whole_curves", {test: _curve(test, 0, "R2") for test in ("confined", CRUSHED)},
        "at least the publication's, 93.5 and 94.2 %",
        lambda n: 93.5 <= n["confined"] <= 100 and 94.2 <= n["unconfined"] <= 100,
    ),
    Row(
        "recovery", SURE,
        ("From three starts, all {inside:.0f} intervals contained the hidden value",),
        "recovery", {"inside": Cell("recovery", "hidden", {"inside": "yes"}, how=len)},
        "at least 17 of 18", lambda n: n["inside"] >= 17,
    ),
    Row(
        "hidden soils", SURE,
        ("All {met:.0f} fits met both numbers, with at most {runs:.0f} simulations",
         "depth was off by {depth:.1f} % (middle; at most {depths:.1f} %) and the force by "
         "{force:.1f} % (at most {forces:.1f} %)",
         "90 % intervals hold {held:.0f} % of the hidden parameters"),
        "hidden_soils",
        {
            "met": _hidden(r"(\d+) of 20 fits meet both numbers"),
            "runs": _hidden(r"at most (\d+) runs come before"),
            **{name: _hidden(rf"off by ({NUMBER}) and ({NUMBER}) % in {of}", part)
               for part, of, name in (
                   (0, "depression", "depth"), (1, "depression", "depths"),
                   (0, "crushing", "force"), (1, "crushing", "forces"))},
            "held": _hidden(r"any parameter in (\d+) %"),
        },
        "20 fits meet both, depth within 2.8 %, force within 12 %, at least 82 % held",
        lambda n: n["met"] == 20 and n["depths"] <= 2.8 and n["forces"] <= 12 and n["held"] >= 82,
    ),
    Row(
        "fits from three starts", SURE,
        ("from three starts of the bundled soil, fits on it took {l0:.0f} to {l1:.0f} processor "
         "seconds, and fits on smaller beds {b0:.0f} to {b1:.0f}",),
        "starts",
        {
            f"{letter}{part - 1}": Cell("recovery", part=part, line=rf"Explored on {way}: 3 of (3) "
                                        rf"fits meet both numbers, in (\d+) to (\d+)")
            for letter, way in (("l", "library"), ("b", "smaller beds")) for part in (1, 2)
        },
        "all fits meet both numbers; the library's slowest is quicker than any other",
        lambda n: n["l1"] < n["b0"],
    ),
    Row(
        "promises", "docs/howto/posterior.md",
        ("Of 20 other soils, whole curves left {middle:.2f} times ({low:.2f} to {high:.2f}) the "
         "deviations that were promised",),
        "sound_soils",
        {name: Cell("posterior", part=part, line=rf"Whole curves of 20 soils leave ({NUMBER}) "
                    rf"times \(({NUMBER}) to ({NUMBER}),")
         for part, name in enumerate(("middle", "low", "high"))},
        "no more is left than was promised, and not less than two thirds of it",
        lambda n: n["low"] >= 0.67 and n["high"] <= 1.0,
    ),
    Row(
        "slopes at other soils", "docs/derivatives.md",
        ("{h:.0f} % of {hs:.0f} of H and {f:.0f} % of {fs:.0f} of F lie within three errors",),
        "audit",
        {name: Cell("audit", part=part, line=rf"{of}: .* of (\d+) slopes .*, (\d+) % .* 3 errors")
         for of, names in (("depth_mm", "hs h"), ("force_n", "fs f"))
         for part, name in enumerate(names.split())},
        "at least 90 %", lambda n: min(n["h"], n["f"]) >= 90,
    ),
    Row(
        "slopes of fits", SURE,
        ("every slope of H was within {depth:.0f} % of the reference",
         "Slopes of F were within {force:.0f} %, except those below 30 N",
         "the wrong sign ({tangential:.0f} %)"),
        "audit",
        {
            "depth": _slope("H", re.compile(""), _size),
            "force": _slope("F", re.compile("(?!tangential)"), _size),
            "tangential": _slope("F", "tangential_multiplier"),
        },
        "slopes of H within 3.5 %, those of F but for the smallest within 35 %",
        _within({"depth": 3.5, "force": 35.0}),
    ),
    Row(
        "LIGGGHTS at equal parameters", SURE,
        ("H is {h:.1f} ± {he:.1f} % smaller there and F {f:.1f} ± {fe:.1f} % larger",
         "their H differs by {h0:+.1f}, {h1:+.1f} and {h2:+.1f} %, and their F by {f0:+.1f}, "
         "{f1:+.1f} and {f2:+.1f} % (standard errors {low:.1f} to {high:.1f} %)"),
        "codes",
        {
            "h": _level("H"), "he": _level("H", 1), "f": _level("F"), "fe": _level("F", 1),
            "low": _codes("F (N)", min, 1), "high": _codes("F (N)", max, 1),
            **{f"{of[0].lower()}{k}": _codes(of, _largest, soil=soil) for of in ("H (mm)", "F (N)")
               for k, soil in enumerate(("wheat_after_rice", "trumao", "strong"))},
        },
        "depth within 1 %, force within 5 %",
        _within({"h": 1.0, "f": 5.0, "h0": 1, "h1": 1, "h2": 1, "f0": 5, "f1": 5, "f2": 5}),
    ),
    Row(
        "one contact in LIGGGHTS", SURE,
        ("One contact along a whole loop agreed within 2e-6 of the largest force",),
        "export_contact",
        {leg: Cell("export_contact", leg, {"soil": re.compile("")}, 0, _size, STUDIES)
         for leg in ("load", "unload", "reload", "separate")},
        "every leg within 2e-6", lambda n: max(n.values()) <= 2e-6,
    ),
    Row(
        "any plausible soil", SURE,
        ("for all {soils:.0f} soils drawn", "changed H by {median:.2f} % (median) and at most "
         "{largest:.1f} %", "time step {longer:.0f} of the {soils:.0f} failed"),
        "prior",
        {name: Cell("convergence", column, {"spheres": "500"}) for name, column in (
            ("soils", "soils"), ("failed", "failed"), ("median", "median"),
            ("largest", "H changed by half the step, largest"),
            ("longer", "failed with 1.3 times the step"))},
        "none fails; the median is at most 0.1 %, the largest at most 2 %",
        lambda n: n["failed"] == 0 and n["median"] <= 0.1 and n["largest"] <= 2,
    ),
    Row(
        "convergence", SURE,
        ("H scatters by {h:.2f} mm (4 %) and F by {f:.0f} N (12 %)",
         *(f"| {{dh{k}:+.3f}} ± {{eh{k}:.3f}} mm | {{df{k}:z.0f}} ± {{ef{k}:.0f}} N |"
           for k in VARIANTS)),
        "convergence",
        {
            "h": _variant("as the preset", "H (mm) ± scatter", 1),
            "f": _variant("as the preset", "F (N) ± scatter", 1),
            **{f"{n}{of.lower()}{k}": _variant(v, f"Δ{of} ± s.e.", part)
               for k, v in VARIANTS.items() for of in "HF" for part, n in enumerate("de")},
        },
        "changes within three standard errors, or 0.015 mm and 15 N",
        lambda n: (_small([(f"dh{k}", f"eh{k}") for k in VARIANTS], 0.015)(n)
                   and _small([(f"df{k}", f"ef{k}") for k in VARIANTS], 15.0)(n)),
    ),
    Row(
        "number of spheres", SURE,
        ("has an H of {h150:.2f}, {h500:.2f}, {h2000:.2f} and {h20000:.2f} mm and an F of "
         "{f150:.0f}, {f500:.0f}, {f2000:.0f} and {f20000:.0f} N",
         "falls from {s150:.0f} over {s500:.0f} to {s2000:.0f} N"),
        "resolution",
        {
            **{f"{of[0].lower()}{n}": _bed(n, of) for of in ("H (mm)", "F (N)")
               for n in (150, 500, 2000, 20000)},
            **{f"s{n}": _bed(n, "F (N)", 1) for n in (150, 500, 2000)},
        },
        "H falls from size to size, and the scatter of F with it",
        lambda n: (n["h150"] > n["h500"] > n["h2000"] > n["h20000"] and n["s150"] > n["s2000"]),
    ),
    Row(
        "fits with small specimens", SURE,
        ("{hw:.0f} and {ht:.0f} % too low and F {fw:.0f} and {ft:.0f} % too high",
         "within {bw:.1f} % for wheat after rice and within {bt:.1f} % for trumao, and F was "
         "{fw0:.1f} to {fw1:.1f} % and {ft0:z.1f} to {ft1:.1f} % too high",
         "It costs {least:.2f} to {most:.2f} times as much as fitting with 2000 spheres from the "
         "start"),
        "sizes",
        {
            "hw": _sizes(DEPTH, "small", WHEAT, _size), "ht": _sizes(DEPTH, "small", TRUMAO, _size),
            "fw": _sizes(FORCE, "small", WHEAT), "ft": _sizes(FORCE, "small", TRUMAO),
            "bw": _sizes(DEPTH, "both", WHEAT, _size), "bt": _sizes(DEPTH, "both", TRUMAO, _size),
            "fw0": _sizes(FORCE, "both", WHEAT, min), "fw1": _sizes(FORCE, "both", WHEAT, max),
            "ft0": _sizes(FORCE, "both", TRUMAO, min), "ft1": _sizes(FORCE, "both", TRUMAO, max),
            "least": _sizes({}, "both", {}, min, "over large only"),
            "most": _sizes({}, "both", {}, max, "over large only"),
        },
        "with both sizes H is within 4 %, at less than half the cost",
        _within({"bw": 4.0, "bt": 4.0, "most": 0.5}),
    ),
    Row(
        "specimens made again", SURE,
        ("up to {hl:.1f} % in H and {fl:.0f} % in F, and their means by {h:+.1f} ± {he:.1f} % and "
         "{f:+.1f} ± {fe:.1f} %",),
        "again",
        {
            f"{of}{name}": _again(observable, column, part)
            for of, observable in (("h", "depression_depth_mm"), ("f", "crushing_force_n"))
            for name, column, part in (("", "mean difference (%)", 0),
                                       ("e", "mean difference (%)", 1), ("l", "largest (%)", 0))
        },
        "means within three standard errors",
        lambda n: abs(n["h"]) <= 3 * n["he"] and abs(n["f"]) <= 3 * n["fe"],
    ),
    Row(
        "cost of derivatives", "docs/derivatives.md",
        ("as long as {confined:.1f} runs without, and both tests as long as {both:.1f}",),
        "tangents",
        {name: Cell("tangents", line=rf"forward runs: confined ({NUMBER}), both tests ({NUMBER})",
                    part=part) for part, name in enumerate(("confined", "both"))},
        "less than seven pairs of runs, 14", _within({"confined": 14, "both": 14}),
    ),
    Row(
        "cost of a calibration", "docs/howto/how-long.md",
        ("needed {g0:.0f}, {g1:.0f} and {g2:.0f} simulations a packing by slopes, and {n0:.0f}, "
         "{n1:.0f} and {n2:.0f} by the Nelder-Mead",),
        "calibration",
        {f"{way[0].lower()}{k}": _calibration(start, way) for way in ("gradient", "Nelder-Mead")
         for k, start in enumerate(STARTS)},
        "fewer by slopes from every start",
        lambda n: all(n[f"g{k}"] < n[f"n{k}"] for k in range(3)),
    ),
    Row(
        "designed experiments", "docs/doe.md",
        ("| designed experiments | {designs:.0f} |", "best point | {gradient:.0f} |"),
        "designs",
        {name: Cell("designs", "simulations", {"method": method}) for name, method in (
            ("designs", "designed experiments"), ("gradient", "gradient fit"))},
        "fewer by slopes", lambda n: n["gradient"] < n["designs"],
    ),
    Row(
        "malformed files", "docs/reliability.md",
        tuple(f"| {{m{k}:.0f}} | {{r{k}:.0f}} | {{u{k}:.0f}} |" for k in range(3)),
        "fuzz",
        {f"{n}{k}": Cell("reliability", column, {"file": file})
         for k, file in enumerate(("lab", "curve", "export"))
         for n, column in (("m", "made"), ("r", "refused (status 2, one line)"),
                           ("u", "still usable (status 0)"), ("x", "traceback or other status"))},
        "none leads to a traceback or another status",
        lambda n: n["x0"] == n["x1"] == n["x2"] == 0,
    ),
    Row(
        "kills", "docs/reliability.md",
        ("No run is lost, none is repeated, and every result is that of the undisturbed run",),
        "kills",
        {name: Cell("reliability", name, {"kills": re.compile("")}, how=_size)
         for name in ("pieces lost", "repeated", "results that differ")},
        "no loss, no repetition, no difference", lambda n: not any(n.values()),
    ),
)  # fmt: skip
