"""Decides, while LIGGGHTS waits, which spheres have crushed and which bonds have broken.

LIGGGHTS has neither; in.tests calls this script now and then (`shell`), which reads a dump and
writes verdict.in, commands that the simulation then obeys: a sphere whose largest contact force
passed its own strength becomes type 8 for good, a bond stretched beyond its strength is deleted
for good.  Only the standard library, because it starts a hundred times a test.
"""

import math
import random
import sys
from pathlib import Path

CRUSHED_BOND = 1.0  # compression that breaks a bond, over the tension that does
EVERY = 5  # rounds of the loop between two looks
STRENGTH_SCATTER = 0.25  # ln-scatter of the strength of spheres


def crush_commands(force: float, seed: int) -> str:
    """referee.in of spheres that crush at a contact force of about `force` N."""
    return _called(
        "dump look all local 1 look.txt c_pairs[1] c_pairs[2] c_pairs[4] c_pairs[5] c_pairs[6]\n",
        f"crush {force:.6g} {seed}",
    )


def bond_commands(stretch: float) -> str:
    """referee.in of bonds that break when they are longer by `stretch` m."""
    return _called("dump look all custom 1 look.txt id x y z\n", f"bonds {stretch:.6g}")


def _called(dump: str, arguments: str) -> str:
    """Every few rounds: dump, ask, obey."""
    return (
        f"variable due equal ${{tick}}%{EVERY}\n"
        'if "${due} != 0" then "jump SELF not_now"\n'
        + dump
        + "dump_modify look first yes\nrun 0 post no\nundump look\n"
        + f"shell {sys.executable} -S {Path(__file__).resolve()} {arguments}\n"
        + "include verdict.in\nlabel not_now\n"
    )


def bonded_start(bed: str, gap: float, stiffness: float) -> tuple[str, str]:
    """The settled bed as a data file with one bond, of its own type and this stiffness (N/m), for
    every pair nearer than the gap (m).

    Returns the data file, and the LIGGGHTS lines that give each bond its length at rest.
    """
    head, rest = bed.split("Atoms", 1)
    atoms = [row.split() for row in rest.split("Velocities")[0].splitlines() if row.strip()]
    places = {int(a[0]): (float(a[2]), *map(float, a[4:7])) for a in atoms}
    pairs = []
    for first, (d1, *x1) in places.items():
        for second, (d2, *x2) in places.items():
            distance = math.dist(x1, x2)
            if first < second and distance < (d1 + d2) / 2 + gap:
                pairs.append((first, second, distance))
    count = len(pairs)
    head = head.replace(
        "8 atom types", f"{count} bonds\n8 atom types\n{count} bond types\n30 extra bond per atom"
    )
    lines = [" ".join([a[0], a[1], *a[4:7], a[2], a[3], "1"]) for a in atoms]
    bonds = [f"{n} {n} {p[0]} {p[1]}" for n, p in enumerate(pairs, 1)]
    text = head + "Atoms\n\n" + "\n".join(lines) + "\n\nBonds\n\n" + "\n".join(bonds) + "\n"
    rest_lengths = [
        f"bond_coeff {n} {stiffness / 2:.9g} {p[2]:.9g}" for n, p in enumerate(pairs, 1)
    ]
    return text, "\n".join(rest_lengths) + "\n"


def crushed(look: list[list[float]], strengths: dict[int, float]) -> list[int]:
    """Spheres of which a contact (id, id, force vector) is stronger than they are."""
    broken = set()
    for first, second, *force in look:
        size = math.hypot(*force)
        broken |= {int(i) for i in (first, second) if size > strengths.get(int(i), math.inf)}
    return sorted(broken)


def strength_of(sphere: int, mean: float, seed: int) -> float:
    """The contact force, N, at which one sphere crushes."""
    return mean * math.exp(STRENGTH_SCATTER * random.Random(f"{seed} {sphere}").gauss(0, 1))


def torn(
    look: list[list[float]], bonds: list[tuple[int, int, int, float]], limit: float
) -> list[int]:
    """Bonds (number, sphere, sphere, length at rest) stretched beyond a limit (m)."""
    places = {int(row[0]): row[1:] for row in look}
    stretch = {n: math.dist(places[i], places[j]) - rest for n, i, j, rest in bonds}
    return [n for n, s in stretch.items() if s > limit or s < -CRUSHED_BOND * limit]


def read_look() -> list[list[float]]:
    """The rows of the dump."""
    lines = Path("look.txt").read_text().splitlines()
    start = max(n for n, line in enumerate(lines) if line.startswith("ITEM: "))
    return [[float(cell) for cell in line.split()] for line in lines[start + 1 :]]


def verdict_on_spheres(mean: float, seed: int) -> str:
    gone_file = Path("gone.txt")
    gone = set(gone_file.read_text().split()) if gone_file.exists() else set()
    look = read_look()
    spheres = {int(i) for row in look for i in row[:2]}
    strengths = {i: strength_of(i, mean, seed) for i in spheres if str(i) not in gone}
    now = crushed(look, strengths)
    gone_file.write_text("\n".join(sorted(gone | {str(i) for i in now})))
    return "".join(f"set atom {i} type 8\n" for i in now)


def verdict_on_bonds(limit: float) -> str:
    bond_file = Path("bonds.txt")
    rows = [row.split() for row in bond_file.read_text().splitlines()]
    bonds = [(int(n), int(i), int(j), float(rest)) for n, i, j, rest in rows]
    now = set(torn(read_look(), bonds, limit))
    kept = [row for row in rows if int(row[0]) not in now]
    bond_file.write_text("".join(" ".join(row) + "\n" for row in kept))
    return "".join(f"delete_bonds all bond {n} remove\n" for n in sorted(now))


if __name__ == "__main__":
    kind, *numbers = sys.argv[1:]
    if kind == "crush":
        verdict = verdict_on_spheres(float(numbers[0]), int(numbers[1]))
    else:
        verdict = verdict_on_bonds(float(numbers[0]))
    Path("verdict.in").write_text(verdict + "\n")
