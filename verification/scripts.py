"""The scripts that make numbers of pages: their commands, what they cost, and where they write.

Costs are minutes of one core from nothing."""

from verification.reporting import Script

RUN = "python -m verification."
SCRIPTS = {
    "export_contact": Script(
        ("python -m studies.liggghts.export_contact",), 4, "export_contact", "",
        "studies", needs=("liggghts", "yade"),
    ),
    "fuzz": Script((RUN + "fuzz",), 5, "reliability", "Malformed files", physics=False),
    "convergence": Script((RUN + "convergence --packings 8",), 5, "convergence", "Convergence"),
    "again": Script(
        (RUN + "resolution --check --most 500",), 6, "resolution", "The same once more"
    ),
    "rankine": Script((RUN + "closed_forms --parts rankine",), 9, "closed_forms", "Rankine"),
    "ring": Script((RUN + "closed_forms --parts vane",), 1, "closed_forms", "A ring around a vane"),
    "mohr_coulomb": Script(
        (RUN + "shear_boxes --parts tests",), 40, "closed_forms",
        "Direct shear, biaxial test and unconfined strength",
    ),
    "columns": Script(
        (RUN + "shear_boxes --parts columns",), 25, "closed_forms", "Columns between planes"
    ),
    "chain": Script((RUN + "tangents --chain",), 8, "tangents", "A chain that is pulled apart"),
    "diagnosis": Script(("python -m studies.diagnosis",), 8, "diagnosis", "", "studies"),
    "posterior": Script((RUN + "posterior",), 6, "posterior", "Posteriors"),
    "prior": Script((RUN + "prior",), 12, "convergence", "Soils from the whole prior"),
    "audit": Script((RUN + "audit --seeds 21 22", RUN + "audit --others 4",
                     RUN + "audit --seeds 21 22 --halved plasticity_ratio",
                     RUN + "audit --seeds 21 22 --finer 2000"), 170, "audit"),
    "beside": Script((RUN + "beside",), 20, "audit", "Other soils, with runs beside them"),
    "derivatives": Script(
        (RUN + "derivatives",), 40, "tangents", "Fits by derivatives and by pairs of runs"
    ),
    "designs": Script((RUN + "designs",), 40, "designs", "Designed experiments and gradients"),
    "kills": Script((RUN + "kills",), 40, "reliability", "Kills at random moments", physics=False),
    "tangents": Script((RUN + "tangents",), 40, "tangents", "Growth of derivatives"),
    "made_lab": Script((RUN + "made_lab",), 50, "made_lab"),
    "calibration": Script((RUN + "calibration",), 50, "designs", "Cost of a calibration"),
    "resolution": Script((RUN + "resolution",), 50, "resolution", "Resolution"),
    "examples": Script((RUN + "examples",), 110, "examples"),
    "whole_curves": Script((RUN + "whole_curves",), 50, "fresh_packings", "Whole curves"),
    "recovery": Script((RUN + "recovery",), 60, "recovery"),
    "sound_soils": Script((RUN + "sound_soils",), 60, "posterior", "Sound soils"),
    "overdamped": Script(
        tuple(f"{RUN}overdamped --spheres {n} --packings 8 --seed {seed}"
              for n, seeds in ((500, (31, 41, 43, 44)), (1000, (42, 45))) for seed in seeds),
        120, "overdamped",
    ),
    "fresh_packings": Script(
        tuple(f"{RUN}fresh_packings --soils {soil} --seeds {seeds}"
              for soil, seeds in (("wheat_after_rice", "0 1 2"), ("trumao", "0"))),
        130, "fresh_packings", "Fresh packings",
    ),
    "reference_beds": Script(
        (RUN + "reference_beds",), 60, "reference_beds", "Tools on the beds of another code"
    ),
    "starts": Script((RUN + "starts --hidden",), 60, "recovery", "Fits from several starts"),
    "hidden_starts": Script(
        (RUN + "starts --equal --hidden " + " ".join(str(soil) for soil in range(20)),), 240,
        "recovery", "Fits of hidden soils, both ways",
    ),
    "sizes": Script(
        (
            RUN + "sizes --ways both",
            RUN + "sizes --starts base --ways large small",
            RUN + "sizes --soils wheat_after_rice --starts 'stiff, strong' --ways large",
        ),
        190, "sizes",
    ),
    "other_tests": Script((RUN + "other_tests",), 300, "posterior", "Tests that took no part"),
    "hidden_soils": Script((RUN + "hidden_soils",), 240, "posterior", "Hidden soils"),
    "codes": Script(
        ("python -m studies.liggghts.codes --soils wheat_after_rice trumao strong",),
        240, "codes", "", "studies", needs=("liggghts",),
    ),
}  # fmt: skip
