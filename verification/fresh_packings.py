"""Does a fit hold on packings that it has not seen?  `calibrate fit --preset standard`, checked.

For each soil and choice of packings: the command's fresh packings against what was measured, with
the standard error of their mean and the error that a publication states for its own simulation,
and the time that the whole command took.  One fit takes some ten minutes on two idle cores.

    python -m verification.fresh_packings --soils wheat_after_rice --seeds 0 1 2
    python -m verification.fresh_packings --soils trumao --seeds 0

Fits are kept in results/benchmarks; a second call resumes, and then keeps the time of the first.
Writes verification/results/fresh_packings.md after each fit; other fits of the same physics keep
their rows.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from calibrate.io.lab import bundled_lab
from calibrate.labtests.composite import label
from verification import reporting

HEADER = ("soil", "seed", "observable", "measured", "fresh packings: mean ± s.e.", "one packing",
          "error", "published error", "packings", "D/d", "simulated in the last call",
          "minutes")  # fmt: skip


def fitted(soil: str, seed: int, folder: Path) -> dict:
    """The command's result, and how long its first call took (s); None if that one resumed."""
    out = folder / f"{soil}-{seed}"
    begun, resumed = time.perf_counter(), (out / "runs").exists()
    command = [sys.executable, "-m", "calibrate", "fit", str(bundled_lab(soil))]
    options = ["--preset", "standard", "--seed", str(seed), "--out", str(out)]
    subprocess.run([*command, *options], check=True)
    clock = out / "seconds.json"
    if not clock.exists():
        clock.write_text(json.dumps(None if resumed else time.perf_counter() - begun))
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    return {**result, "seconds": json.loads(clock.read_text())}


def rows(soil: str, seed: int, result: dict) -> list[dict]:
    """One row a target."""
    fresh, count = result["fresh_packings"], len(result["fresh_seeds"])
    return [
        {
            "soil": soil,
            "seed": seed,
            "observable": name,
            "measured": target["mean"],
            "mean": fresh["observables"][name],
            "scatter": fresh["spread"][name],
            "standard_error": fresh["spread"][name] / count**0.5,
            "error": fresh["observables"][name] / target["mean"] - 1,
            "published_error": target.get("published_error"),
            "packings": count,
            "spheres_across": result["quality"]["spheres_across"],
            "free": result["free"],
            "simulations": result["simulations"],
            "seconds": result["seconds"],
        }
        for name, target in result["measured"]["targets"].items()
    ]


def markdown(found: list[dict], origin: dict) -> str:
    cells = [
        [
            row["soil"],
            str(row["seed"]),
            label(row["observable"]),
            f"{row['measured']:.4g}",
            f"{row['mean']:.4g} ± {row['standard_error']:.2g}",
            f"± {row['scatter']:.2g}",
            f"{100 * row['error']:+.1f} %",
            f"{100 * row['published_error']:.1f} %" if row["published_error"] else "-",
            str(row["packings"]),
            f"{row['spheres_across']:.1f}",
            str(row["simulations"]),
            f"{row['seconds'] / 60:.1f}" if row["seconds"] else "resumed",
        ]
        for row in found
    ]
    head = "# Fresh packings\n\nFits at the preset standard, on packings that took no part.\n\n"
    return head + reporting.table(HEADER, cells) + reporting.footer(origin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--soils", nargs="+", default=["wheat_after_rice"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    chosen = parser.parse_args()
    folder = reporting.kept("fresh_packings").resolve()
    found = list(reporting.earlier("fresh_packings", "rows"))
    for soil in chosen.soils:
        for seed in chosen.seeds:
            found = [row for row in found if (row["soil"], row["seed"]) != (soil, seed)]
            found += rows(soil, seed, fitted(soil, seed, folder))
            found.sort(
                key=lambda row: (row["soil"] != "wheat_after_rice", row["soil"], row["seed"])
            )
            origin = reporting.provenance()
            content = {**origin, "rows": found}
            reporting.write_content("fresh_packings", content)
            reporting.write_section("fresh_packings", markdown(found, origin))


if __name__ == "__main__":
    main()
