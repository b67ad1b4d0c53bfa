"""A self-contained HTML page from a template of `templates/`.

Every text that enters a template is escaped.  Pictures are embedded, styles stand in the page,
and its content policy forbids any request.  A new kind of report is one more template that
extends `base.html` and fills its blocks `title`, `lead` and `content`; `parts.html` has what
they share.
"""

import base64
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
import numpy as np

from calibrate.figures import functions
from calibrate.io.choices import plain
from calibrate.io.labfile import PARAMETER_UNITS

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("calibrate.reports"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


@dataclass(frozen=True)
class Picture:
    """An SVG drawing, what it shows in words for those who cannot see it, and its caption."""

    svg: str
    alt: str
    caption: str


@dataclass(frozen=True)
class Table:
    """Cells as text, the first of each row its heading; numbers are set flush right.

    On a phone each row becomes a card in which the names of the columns label the cells.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    text: bool = False  # words rather than numbers


@dataclass(frozen=True)
class Page:
    """A whole report, and the sentence that sums it up."""

    sentence: str
    html: str


def render(template: str | Path, **content: object) -> str:
    """The page that `template` makes of `content`; a path is of a template outside `templates/`,
    which may extend those inside."""
    if isinstance(template, str):
        return TEMPLATES.get_template(template).render(**content)
    text = template.read_text(encoding="utf-8")
    return TEMPLATES.from_string(text).render(**content)


def embedded(svg: str) -> str:
    """An SVG drawing as an address that an <img> can show without a request."""
    code = base64.b64encode(svg.encode("utf-8")).decode("ascii")
    return f"data:image/svg+xml;base64,{code}"


def pictures_of(
    verb: str,
    *drawn: object,
    captions: Mapping[str, tuple[str, str]] | None = None,
    skipped: int = 0,
) -> dict[str, Picture]:
    """A verb's figures by name, drawn from `drawn`, but for the first few that a page shows its own
    way; alt text and caption are the first paragraph of the docstring where `captions` has none."""
    from calibrate.figures.style import svg  # matplotlib, which a page without figures needs not

    pictures = {}
    for name, draw in list(functions(verb).items())[skipped:]:
        said = " ".join((inspect.getdoc(draw) or "").partition("\n\n")[0].split())
        if (figure := draw(*drawn)) is not None:
            pictures[name] = Picture(svg(figure), *(captions or {}).get(name, (said, said)))
    return pictures


def number(value: float | None, digits: int = 5) -> str:
    """A number for reading: `digits` significant digits, a true minus, a dash for none.

    Powers of ten stand only below 0.0001 and from ten million.
    """
    if value is None or np.isnan(value):
        return "–"
    text = f"{value:.{digits}g}"
    if 1 <= abs(value) < 1e7:
        text = np.format_float_positional(float(text), trim="-")
    return text.replace("-", "−")


def words(name: str) -> str:
    """A name of the program as words."""
    return name.replace("_", " ")


def quantity(name: str, value: float | None, digits: int = 4) -> str:
    """A parameter's value for reading, with its unit; moduli in MPa, diameters in µm."""
    unit = PARAMETER_UNITS.get(plain(name), "")
    if unit == "Pa" and value is not None:
        value, unit = value / 1e6, "MPa"
    elif name == "reference_diameter" and value is not None:
        value, unit = 1e6 * value, "µm"
    return f"{number(value, digits)} {unit}".strip().replace("J/m^2", "J/m²")


def plus_minus(value: float, scatter: float) -> str:
    """A value with its scatter; the value alone where that is not known."""
    if np.isnan(scatter):
        return number(value, 4)
    return f"{number(value, 4)} ± {number(scatter, 2)}"


TEMPLATES.filters["words"] = words
TEMPLATES.filters["number"] = number
TEMPLATES.filters["embedded"] = embedded
