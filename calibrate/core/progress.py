"""Progress of long work: a bar on a terminal, plain lines elsewhere, silence by default."""

import abc
import sys
import time
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class AbstractProgress(abc.ABC):
    """Told what starts, what is done, and what is worth saying."""

    @abc.abstractmethod
    def start(self, what: str, total: int) -> None:
        """A piece of work with `total` parts begins."""

    @abc.abstractmethod
    def advance(self) -> None:
        """One part is done."""

    @abc.abstractmethod
    def finish(self) -> None:
        """The piece of work is over, or was interrupted."""

    @abc.abstractmethod
    def say(self, line: str) -> None:
        """A line for the reader."""


class Silent(AbstractProgress):
    """Says nothing."""

    def start(self, what: str, total: int) -> None:
        pass

    def advance(self) -> None:
        pass

    def finish(self) -> None:
        pass

    def say(self, line: str) -> None:
        pass


class PlainLines(AbstractProgress):
    """A line when work starts and at most one every `every` seconds; for logs and pipes."""

    def __init__(self, every: float = 10.0, stream: TextIO = sys.stderr):
        self._every, self._stream = every, stream
        self._what, self._total, self._done = "", 0, 0
        self._begun = self._last = time.monotonic()

    def start(self, what: str, total: int) -> None:
        self._what, self._total, self._done = what, total, 0
        self._begun = self._last = time.monotonic()
        self.say(f"{what}: {total} to do")

    def advance(self) -> None:
        self._done += 1
        now = time.monotonic()
        if now - self._last >= self._every and self._done < self._total:
            self._last = now
            left = (now - self._begun) / self._done * (self._total - self._done)
            self.say(f"{self._what}: {self._done}/{self._total}, about {duration(left)} left")

    def finish(self) -> None:
        seconds = time.monotonic() - self._begun
        self.say(f"{self._what}: {self._done}/{self._total} in {duration(seconds)}")

    def say(self, line: str) -> None:
        print(line, file=self._stream, flush=True)


class Bar(AbstractProgress):
    """A bar with the time left, on a terminal."""

    def __init__(self, console: Console):
        self._console = console
        self._bar: Progress | None = None

    def start(self, what: str, total: int) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        self._bar = Progress(*columns, TimeRemainingColumn(), console=self._console)
        self._bar.start()
        self._bar.add_task(what, total=total)

    def advance(self) -> None:
        if self._bar is not None:
            self._bar.advance(self._bar.task_ids[0])

    def finish(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def say(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False)


def duration(seconds: float) -> str:
    """A length of time in the two units that matter: 48 s, 12 min 5 s, 3 h 20 min, 2 d 4 h."""
    whole = round(seconds)
    minutes, hours, days = whole // 60, whole // 3600, whole // 86400
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{minutes} min {whole % 60} s"
    if whole < 86400:
        return f"{hours} h {minutes % 60} min"
    return f"{days} d {hours % 24} h"


def for_terminal() -> AbstractProgress:
    """A bar if standard error is a terminal, plain lines otherwise."""
    console = Console(stderr=True)
    return Bar(console) if console.is_terminal else PlainLines()
