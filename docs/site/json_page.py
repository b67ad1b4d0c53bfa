"""The reference of JSON keys: docs/json.md, then the records that check what the program reads."""

import sys
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

HEAD = Path(__file__).parents[1] / "json.md"


def records() -> dict[str, type[BaseModel]]:
    """The record of each verb that has one."""
    from calibrate.records.audit import AuditRecord
    from calibrate.records.diagnosis import DiagnosisRecord
    from calibrate.records.fit import FitRecord
    from calibrate.records.study import StudyRecord

    return {
        "fit": FitRecord,
        "audit": AuditRecord,
        "doe": StudyRecord,
        "diagnose": DiagnosisRecord,
    }


def page() -> str:
    """What docs/json.md says, and every record with the records inside it."""
    parts = [HEAD.read_text(encoding="utf-8")]
    for verb, kind in records().items():
        parts += [f"## Keys of `{verb}`", ""]
        parts += [_table(model) for model in _inside(kind)]
    return "\n".join(parts)


def _inside(kind: type[BaseModel]) -> list[type[BaseModel]]:
    """The record and all records that its keys hold, each once."""
    found: list[type[BaseModel]] = []
    waiting = [kind]
    while waiting:
        model = waiting.pop(0)
        if model not in found:
            found.append(model)
            waiting += [m for f in model.model_fields.values() for m in _models(f.annotation)]
    return found


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _table(model: type[BaseModel]) -> str:
    doc = " ".join((model.__doc__ or "").split())
    lines = [f"### {model.__name__}", "", doc, "", "| key | holds |", "| --- | --- |"]
    for name, field in model.model_fields.items():
        lines.append(f"| `{field.alias or name}` | {written(field.annotation)} |")
    return "\n".join([*lines, ""])


def written(annotation: Any) -> str:
    """A type in words: number, text, list of ..., one of ..., the name of a record."""
    if isinstance(annotation, type) and not get_args(annotation):
        plain = {float: "number", int: "count", str: "text", bool: "true or false"}
        return plain.get(annotation, annotation.__name__)
    parts, origin = get_args(annotation), getattr(annotation, "__origin__", None)
    if origin in (list, tuple):
        return "list of " + ", ".join(dict.fromkeys(written(p) for p in parts if p is not ...))
    if origin is dict:
        return f"{written(parts[1])} by {written(parts[0])}"
    if str(annotation).startswith("typing.Literal"):
        return "one of " + ", ".join(f"`{part}`" for part in parts)
    if hasattr(annotation, "__metadata__"):
        return written(parts[0])
    named = [written(p) for p in parts if p is not type(None)]
    return " or ".join(named) + ("" if len(named) == len(parts) else " or null")


if __name__ == "__main__":
    sys.stdout.write(page())
