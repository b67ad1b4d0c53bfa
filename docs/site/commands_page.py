"""The reference of the command line: every verb with its arguments and options."""

from typing import Any

HEAD = """# Command line

`calibrate VERB --help` says the same on the terminal. A second run of a command with the same
`--out` reuses every finished simulation.

| exit status | meaning |
| --- | --- |
| 0 | done |
| 2 | the input is wrong: one line names file, field and repair |
| 1 | anything else |
"""


def page() -> str:
    """All verbs in the order of `calibrate --help`."""
    from calibrate.verbs import VERBS
    from calibrate.verbs.command import command_of

    return "\n".join([HEAD, *[_verb(name, command_of(name)) for name in VERBS]])


def _verb(name: str, verb: Any) -> str:
    rows = [_row(parameter) for parameter in verb.params]
    head = ["| argument or option | meaning | default |", "| --- | --- | --- |"]
    summary = " ".join((verb.help or "").split())
    return "\n".join([f"## {name}", "", summary, "", *head, *rows, ""])


def _row(parameter: Any) -> str:
    names = [*parameter.opts, *parameter.secondary_opts]
    shown = " / ".join(f"`{name}`" for name in names if name.startswith("--"))
    shown = shown or f"`{parameter.metavar or parameter.name.upper()}`"
    meaning = (getattr(parameter, "help", "") or "").replace("|", "\\|")
    default = "" if parameter.default is None else f"`{parameter.default}`"
    return f"| {shown} | {meaning} | {default} |"
