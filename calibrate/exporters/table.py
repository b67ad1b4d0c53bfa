"""CSV: one row a parameter, for a spreadsheet that compares soils."""

import csv
import io

from calibrate.exporters.notes import heading, scale_up, warned
from calibrate.exporters.source import UNITS, Found, in_order

NAME, FILE = "csv", "soil.csv"
COLUMNS = ("parameter", "value", "unit", "low_95", "high_95", "fitted")


def text(found: Found) -> str:
    """The table (SI units); lines that begin with # say where it comes from and warn."""
    notes = [*heading(found), *warned(found), *scale_up(found)]
    out = io.StringIO()
    out.writelines(f"# {sentence}\n" for sentence in notes)
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for name in in_order(found.values):
        ends = found.intervals.get(name, ("", ""))
        writer.writerow([name, f"{found[name]:.7g}", UNITS[name], *ends, name in found.intervals])
    return out.getvalue()
