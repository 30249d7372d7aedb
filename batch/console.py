"""What the command line shows while it works: messages and a progress bar, on standard error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich import progress as bars
from rich.console import Console
from rich.table import Column

from .process import Progress

console = Console(stderr=True, highlight=False, soft_wrap=True)


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar that is gone at the end, and what moves it."""
    columns = (
        bars.BarColumn(bar_width=20),
        bars.TaskProgressColumn(),
        bars.TimeRemainingColumn(),
        bars.TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
        ),
    )
    # A log file gets no bar; there it would come as one empty line.
    is_hidden = not console.is_terminal
    with bars.Progress(
        *columns, console=console, transient=True, expand=True, disable=is_hidden
    ) as bar:
        task = bar.add_task("Starting", total=None)

        def advance(fraction: float, text: str) -> None:
            # Without a fraction nobody knows how long it takes: the bar just moves.
            bar.update(task, completed=fraction, total=1 if fraction else None, description=text)

        yield advance
