"""What is said when the user's input is wrong: one line with file, field, problem and repair.

    lab.toml: field 'specimen.height': negative length -30 mm; give a positive length such as ...

The command line prints that line and exits with status 2; a notebook shows it as the
message of the exception.  Nothing here is raised for faults of the program itself.
"""

import difflib
from collections.abc import Iterable
from typing import Any

COMMAND_LINE = "command line"  # the "file" of an option that is wrong


class InputError(Exception):
    """Input that cannot be used.

    `file` is the path as the user gave it, `field` the dotted name inside it ("" when the whole
    file is meant), `problem` what is wrong with it and `repair` what to write instead.
    """

    def __init__(self, file: str, field: str, problem: str, repair: str):
        super().__init__(file, field, problem, repair)
        self.file = file
        self.field = field
        self.problem = problem
        self.repair = repair

    def __str__(self) -> str:
        where = f"{self.file}: field '{self.field}'" if self.field else self.file
        return one_line(f"{where}: {self.problem}; {self.repair}")


class BadValue(ValueError):
    """A value that is refused where file and field are not known yet; `at` adds them.

    `name` is the entry of a table that is meant, when the refusal comes from the whole table.
    """

    def __init__(self, problem: str, repair: str, name: str = ""):
        super().__init__(problem, repair, name)
        self.problem = problem
        self.repair = repair
        self.name = name

    def at(self, file: str, field: str) -> InputError:
        """The same refusal as an error about `field` of `file`."""
        full_name = ".".join(part for part in (field, self.name) if part)
        return InputError(file, full_name, self.problem, self.repair)


def suggestion(name: str, known: Iterable[str]) -> str:
    """A repair for the unknown `name`: the nearest of the `known` names, or all of them."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return f"did you mean '{close[0]}'?" if close else "known names: " + ", ".join(names)


def shown(value: object, width: int = 60) -> str:
    """`value` as it may stand in a message: its repr, cut to `width` characters."""
    text = repr(value)
    return text if len(text) <= width else text[: width - 3] + "..."


def one_line(text: str) -> str:
    """`text` on a single line, with characters that a terminal cannot print replaced by '?'."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else "?" for c in line)


class CalibrationError(RuntimeError):
    """A calibration cannot go on, in one sentence; what was simulated stays on disk.

    `result` is what there is all the same, where a verb found something; None otherwise.
    """

    def __init__(self, sentence: str, result: Any = None):
        super().__init__(sentence)
        self.result = result
