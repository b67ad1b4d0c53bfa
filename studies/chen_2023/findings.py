"""What the figures mean together: statements in words, every number in them computed.

Also the statistics that a response-surface analysis owes its reader and the paper does not
print: R2 in its three forms, adequate precision, lack of fit.
"""

from dataclasses import dataclass

import numpy as np

from calibrate.designs.anova import Anova, pure_error
from studies.chen_2023 import depth, force, screening, sweep
from studies.chen_2023.levels import FACTORS
from studies.chen_2023.tables import in_text, printed, table


@dataclass(frozen=True)
class Finding:
    """A statement in one or two sentences and the numbers in it, by name."""

    name: str
    statement: str
    values: dict[str, float]


def findings() -> list[Finding]:
    """All of them, in the order of the paper."""
    return [
        depth_screening(),
        force_screening(),
        depth_tripled(),
        depth_optimum(),
        force_analysis(),
        force_equation(),
        force_optimum(),
        centre_points(),
        multiplier(),
    ]


def depth_screening() -> Finding:
    """Table 7 against Table 2."""
    found = screening.screening("depression_depth")
    least = min(FACTORS, key=lambda name: found[name].p)
    values = {
        "total_of_table_2": found.total_sum_of_squares,
        "total_implied_by_table_7": float(screening.implied_total("depression_depth").mean()),
        "static_friction_percent": found["static_friction"].contribution,
        "static_friction_percent_printed": table(7)
        .cell("static_friction", "contribution_percent")
        .value,
        "smallest_p": found[least].p,
    }
    statement = (
        "Table 7 does not come from Table 2: its total sum of squares is {total_of_table_2:.2f}, "
        "the printed rows imply {total_implied_by_table_7:.1f}. Static friction contributes "
        "{static_friction_percent:.0f} %, not {static_friction_percent_printed:.0f} %, and no "
        "factor is significant for depth (smallest p {smallest_p:.3f}, {name})."
    )
    words = statement.format(**values, name=least.replace("_", " "))
    return Finding("depth screening", words, values)


def force_screening() -> Finding:
    """Table 8 against Table 2."""
    found = screening.screening("crushing_force")
    column = table(8).values("contribution_percent")
    gaps = [abs(found[n].contribution - c) for n, c in zip(FACTORS, column, strict=True)]
    totals = screening.implied_total("crushing_force")
    values = {
        "largest_gap_percentage_points": max(gaps),
        "total_of_table_2": found.total_sum_of_squares,
        "least_total_implied": float(totals.min()),
        "largest_total_implied": float(totals.max()),
    }
    statement = (
        "Table 8's contributions keep the order of Table 2's and lie within "
        "{largest_gap_percentage_points:.1f} percentage points of them. Its effects and sums of "
        "squares are of other data, and not of one set: the totals that its rows imply run from "
        "{least_total_implied:,.0f} to {largest_total_implied:,.0f}, Table 2's is "
        "{total_of_table_2:,.0f}."
    )
    return Finding("force screening", statement.format(**values), values)


def depth_tripled() -> Finding:
    """Table 9 and the depth equation against Table 3."""
    found = depth.analysis(3 * depth.depths())
    off = [
        abs(depth.equation_values()[name].value / (3 * measured.value) - 1)
        for name, measured in depth.depth_at_points().items()
    ]
    values = {
        "largest_deviation_percent": 100 * max(off),
        "model_sum_of_squares": found["Model"].sum_of_squares,
        "residual_sum_of_squares": found["Residual"].sum_of_squares,
        "residual_df": float(found["Residual"].df),
        "pure_error_sum_of_squares": found["Pure error"].sum_of_squares,
        "pure_error_df": float(found["Pure error"].df),
    }
    statement = (
        "Table 9 and the depth equation belong to three times the depth of Table 3: at all nine "
        "design points the equation is three times the table within "
        "{largest_deviation_percent:.2f} %. Table 9's residual row is the pure error "
        "({pure_error_sum_of_squares:.3f}, df {pure_error_df:.0f}); the residual is "
        "{residual_sum_of_squares:.3f} with {residual_df:.0f} degrees of freedom. Table and "
        "equation are of different models: the table's has seven terms, the equation eight."
    )
    return Finding("depth tripled", statement.format(**values), values)


def depth_optimum() -> Finding:
    """The depth at the published optimum."""
    found = depth.predictions_at_optimum()
    values = {name: number.value for name, number in found.items()}
    refits = (values["cubic"], values["cubic with A^2*B^2"])
    low, high = depth.interval_at_optimum()
    values["half_width_mm"] = (high - low) / 2
    statement = (
        f"At the published depth optimum, meant for {in_text('optimum.depression_depth.target')} "
        f"mm, the cubic refits give {min(refits):.2f} to {max(refits):.2f} mm, the quadratic "
        f"{values['quadratic']:.2f} mm; the cubic's 95 % prediction interval is "
        f"±{values['half_width_mm']:.2f} mm."
    )
    return Finding("depth optimum", statement, values)


def force_analysis() -> Finding:
    """Table 10 against Table 4."""
    found = force.analysis(force.forces())
    values = {
        "largest_deviation_percent": 100 * largest_deviation_of_table_10(),
        "pure_error_sum_of_squares": found["Pure error"].sum_of_squares,
        "pure_error_df": float(found["Pure error"].df),
        "residual_sum_of_squares": found["Residual"].sum_of_squares,
        "residual_df": float(found["Residual"].df),
        "largest_change_n": float(np.max(np.abs(force.forces(force.ANALYSED) - force.forces()))),
    }
    statement = (
        "Table 10 follows from Table 4 within {largest_deviation_percent:.2f} %, once two "
        "misprints are set right: its residual row is the pure error "
        "({pure_error_sum_of_squares:.0f}, df {pure_error_df:.0f}; the residual is "
        "{residual_sum_of_squares:.0f}, df {residual_df:.0f}), and the sum of squares of the "
        "plasticity ratio has two wrong digits. What remains is more than rounding, but with two "
        "responses changed by {largest_change_n:.1f} N every entry is reproduced."
    )
    return Finding("force analysis", statement.format(**values), values)


def largest_deviation_of_table_10() -> float:
    """Largest |computed/printed - 1| of Table 10 with the row named right and D's misprint read
    as its mean square; Table 4 as printed.  p is left out: two digits of it are printed."""
    found, source = force.analysis(force.forces()), table(10)
    lines = {row: found[name] for row, name in force.SOURCES.items()}
    lines["residual"] = found["Pure error"]
    off = []
    for row, line in lines.items():
        computed = {
            "sum_of_squares": line.sum_of_squares,
            "mean_square": line.mean_square,
            "f_value": line.f,
        }
        for column, value in computed.items():
            read_from = "mean_square" if row == "plasticity_ratio" else column
            text = source.text(row, "f_value" if column == "f_value" else read_from)
            off += [abs(value / printed(text).value - 1)] if text else []
    return max(off)


def force_equation() -> Finding:
    """The printed force equation against Table 4."""
    factor, agreeing = force.unit_of_equation()
    runs = sum(name.count(",") if "centre" in name else 1 for name in agreeing)
    values = {
        "factor_low_n": factor.value - factor.reach,
        "factor_high_n": factor.value + factor.reach,
        "runs_that_agree": float(runs),
        "runs": float(len(force.forces())),
        "run_12_n": float(force.forces()[11]),
        "equation_at_run_12_n": factor.value * force.equation_values()["run 12"].value,
    }
    statement = (
        "The force equation is not in newtons: within its rounding Table 4 is "
        "{factor_low_n:.2f} to {factor_high_n:.2f} times it in {runs_that_agree:.0f} of "
        "{runs:.0f} runs. Run 12 is printed as {run_12_n:.2f} N where the equation gives "
        "{equation_at_run_12_n:.0f} N; 313.61 N, with two digits exchanged, would agree. Table 10 "
        "was computed with the printed {run_12_n:.2f} N."
    )
    return Finding("force equation", statement.format(**values), values)


def force_optimum() -> Finding:
    """The force at the published optimum, with its interval, and at the final multiplier."""
    at_optimum, low, high = force.interval_at("optimum.tangential_multiplier")
    at_final, *_ = force.interval_at("final.tangential_multiplier")
    values = {
        "force_n": at_optimum,
        "half_width_n": (high - low) / 2,
        "force_at_final_multiplier_n": at_final,
        "table_5_at_final_multiplier_n": sweep.final_row("crushing_force").value,
    }
    statement = (
        "The published optimum was solved for the abstract's 210 N: the quadratic gives "
        "{force_n:.1f} N there, with a 95 % prediction interval of ±{half_width_n:.0f} N. At the "
        "final multiplier it gives {force_at_final_multiplier_n:.0f} N, Table 5 "
        "{table_5_at_final_multiplier_n:.0f} N."
    )
    return Finding("force optimum", statement.format(**values), values)


def centre_points() -> Finding:
    """The replicated runs of Table 4."""
    rows = np.all(force.points() == [12, 0.5, 0.65], axis=1)
    centre = np.sort(force.forces()[rows])
    split = int(np.argmax(np.diff(centre))) + 1
    low, high = centre[:split], centre[split:]
    squares, df = pure_error(force.points(), force.forces())
    values = {
        "low_group_largest_n": float(low[-1]),
        "high_group_least_n": float(high[0]),
        "in_low_group": float(len(low)),
        "in_high_group": float(len(high)),
        "standard_deviation_n": float(np.sqrt(squares / df)),
    }
    statement = (
        f"The centre runs of Table 4, the same simulation {len(centre)} times, fall in two groups: "
        f"{low[0]:.0f} to {low[-1]:.0f} N ({len(low)} runs) and {high[0]:.0f} to {high[-1]:.0f} N "
        f"({len(high)} runs). Their standard deviation is {np.sqrt(squares / df):.0f} N."
    )
    return Finding("centre points", statement, values)


def multiplier() -> Finding:
    """The stiffness multiplier's effect in Tables 4 and 5."""
    y, x = table(5).values("crushing_force_n"), table(5).values("tangential_multiplier")
    slope = float(np.polyfit(x, y, 1)[0])
    low, high = float(x.min()), float(x.max())
    of_surface = 2 * float(force.surface(force.forces()).coefficients[3])
    values = {
        "effect_in_table_4_n": of_surface,
        "effect_in_table_5_n": slope * (high - low),
    }
    statement = (
        f"From {low:g} to {high:g} the stiffness multiplier raises the force by "
        f"{of_surface:.0f} N in Table 4 and lowers it by {-slope * (high - low):.0f} N in Table 5."
    )
    return Finding("stiffness multiplier", statement, values)


def unprinted() -> list[dict]:
    """Statistics of the models behind Tables 9 and 10 that the paper leaves out."""
    return [
        _statistics("Table 3, quadratic", depth.analysis(depth.depths(), "quadratic")),
        _statistics("Table 3, cubic", depth.analysis(depth.depths())),
        _statistics("Table 4, quadratic", force.analysis(force.forces())),
    ]


def _statistics(model: str, found: Anova) -> dict:
    lack = found["Lack of fit"]
    return {
        "model": model,
        "r2": found.r2.value,
        "adjusted_r2": found.adjusted_r2.value,
        "predicted_r2": found.predicted_r2.value,
        "adequate_precision": found.adequate_precision.value,
        "lack_of_fit_f": lack.f,
        "lack_of_fit_df": f"{lack.df}, {found['Pure error'].df}",
        "lack_of_fit_p": lack.p,
    }
