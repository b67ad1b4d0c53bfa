"""A self-contained HTML page from a template of `templates/`.

Every text that enters a template is escaped.  Pictures are embedded, styles stand in the page,
and its content policy forbids any request.  A new kind of report is one more template that
extends `base.html` and fills its blocks `title`, `lead` and `content`.
"""

import base64
from dataclasses import dataclass

import jinja2
import numpy as np

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("calibrate.report"),
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


def render(template: str, **content: object) -> str:
    """The page that `template` makes of `content`."""
    return TEMPLATES.get_template(template).render(**content)


def embedded(svg: str) -> str:
    """An SVG drawing as an address that an <img> can show without a request."""
    code = base64.b64encode(svg.encode("utf-8")).decode("ascii")
    return f"data:image/svg+xml;base64,{code}"


def number(value: float | None, digits: int = 5) -> str:
    """A number for reading: `digits` significant digits, a true minus, a dash for none.

    Powers of ten stand only below 0.0001 and from ten million.
    """
    if value is None:
        return "–"
    text = f"{value:.{digits}g}"
    if 1 <= abs(value) < 1e7:
        text = np.format_float_positional(float(text), trim="-")
    return text.replace("-", "−")


TEMPLATES.filters["number"] = number
TEMPLATES.filters["embedded"] = embedded
