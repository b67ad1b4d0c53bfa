"""All published figures of the paper with their verdicts, in one call."""

from collections import Counter
from dataclasses import asdict, dataclass

from studies.chen_2023 import depth, force, inside, levels, screening, sweep
from studies.chen_2023.findings import Finding, findings, unprinted
from studies.chen_2023.verdict import Figure, Verdict

SOURCE = (
    "Chen, Gu, Hu, Wu, Luo, Guo (2023), The Calibration of Soil Simulation Parameters for Wheat "
    "Grown after Rice in the Yangtze River Basin of China, Sustainability 15, 15079, "
    "https://doi.org/10.3390/su152015079, CC BY 4.0"
)
ORDER = (
    *(f"Table {number}" for number in range(1, 10)),
    "Depth equation",
    "Table 10",
    "Force equation",
    "Optimum",
    "Verification",
    "Text",
)


@dataclass(frozen=True)
class Reproduction:
    """Figures, relations inside the tables, findings in words, statistics not printed."""

    figures: tuple[Figure, ...]
    inside: tuple[Figure, ...]
    findings: tuple[Finding, ...]
    unprinted: tuple[dict, ...]

    def counts(self) -> dict[str, Counter]:
        """How many figures of each table have which verdict."""
        found: dict[str, Counter] = {}
        for figure in self.figures:
            found.setdefault(figure.table, Counter())[figure.verdict] += 1
        return found

    def total(self) -> Counter:
        return Counter(figure.verdict for figure in self.figures)

    def not_reproduced(self) -> list[Figure]:
        return [f for f in self.figures if f.verdict is Verdict.NOT_REPRODUCED]

    def as_json(self) -> dict:
        total = self.total()
        return {
            "source": SOURCE,
            "figures": [figure.as_json() for figure in self.figures],
            "counts": {str(verdict): total[verdict] for verdict in Verdict},
            "inside_the_tables": [check.as_json() for check in self.inside],
            "findings": [asdict(finding) for finding in self.findings],
            "not_printed": list(self.unprinted),
        }


def reproduce() -> Reproduction:
    """Computes everything from the bundled tables; takes a second or two."""
    modules = (levels, screening, depth, force, sweep)
    figures = [figure for module in modules for figure in module.figures()]
    return Reproduction(
        tuple(sorted(figures, key=lambda figure: ORDER.index(figure.table))),
        tuple(inside.checks()),
        tuple(findings()),
        tuple(unprinted()),
    )
