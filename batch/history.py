"""What a result folder measured in all its versions: results.sqlite, and who became worse.

One row an image: what tells it from others, the run that first measured it, and its line of
results.csv. A version is what the image's header calls its renderer, with a hash of its source.
"""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

from .equal_time import Rows, Spread, confidence_interval, cost_by_seed, group_by, spread
from .images import ImageError
from .metrics import COLUMNS
from .wording import format_budget

# Images that agree in these may be compared, whatever their version and seed.
SUBJECT = ["scene", "file_sha256", "method", "overrides", "budget", "resolution"]
SUBJECT += ["bounces", "threads", "cpu"]
KEYS = ["renderer", "seed", *SUBJECT]
RUN_COLUMNS = ["started", "command", "versions", "platform"]
ALL_COLUMNS = [*KEYS, *RUN_COLUMNS, *(name for name in COLUMNS if name not in KEYS)]


class Entry(NamedTuple):
    """A version's cost, rel_mse * seconds, over seeds.

    against: how many times lower it is than that of the version before, with its 95 % interval;
    None for the first version, or where either has a single seed.
    """

    subject: dict
    renderer: str
    started: str
    cost: Spread
    num_seeds: int
    against: Spread | None

    @property
    def is_worse(self) -> bool:
        """Whether it is beyond the spread of the seeds."""
        return self.against is not None and self.against.high < 1


def record(folder: Path, run: dict, rows: Rows) -> None:
    """Add measured rows to results.sqlite; an image measured again keeps the run it came from."""
    about_run = {"started": run["started"], "command": run["command"]}
    about_run |= {"versions": json.dumps(run["versions"]), "platform": run["machine"]["platform"]}
    about_run |= {name: run[name] for name in ("threads", "bounces")}
    about_run |= {"resolution": "x".join(map(str, run["resolution"]))}
    lines = []
    for row in rows:
        settings = row["header"].get("settings", {})
        line = (
            row | about_run | {name: settings.get(name, "") for name in ("renderer", "file_sha256")}
        )
        line["overrides"] = json.dumps(row["header"].get("overrides", {}), sort_keys=True)
        lines.append([line[name] if line[name] == line[name] else None for name in ALL_COLUMNS])
    again = [name for name in ALL_COLUMNS if name not in (*KEYS, *RUN_COLUMNS)]
    with opened(folder) as database:
        database.execute(
            f"CREATE TABLE IF NOT EXISTS results ({', '.join(ALL_COLUMNS)}, "
            f"PRIMARY KEY ({', '.join(KEYS)}))"
        )
        _add_missing_columns(database)
        database.executemany(
            f"INSERT INTO results ({', '.join(ALL_COLUMNS)}) "
            f"VALUES ({', '.join('?' * len(ALL_COLUMNS))}) ON CONFLICT "
            f"DO UPDATE SET {', '.join(f'{name} = excluded.{name}' for name in again)}",
            lines,
        )


def _add_missing_columns(database: sqlite3.Connection) -> None:
    """Those that the version which made the table did not have; empty in its rows."""
    present = {row["name"] for row in database.execute("PRAGMA table_info(results)")}
    for name in ALL_COLUMNS:
        if name not in present:
            database.execute(f"ALTER TABLE results ADD COLUMN {name}")


@contextmanager
def opened(folder: Path) -> Iterator[sqlite3.Connection]:
    """results.sqlite of a folder, with rows as dictionaries; a block that fails changes nothing."""
    path = folder / "results.sqlite"
    try:
        with closing(sqlite3.connect(path)) as database, database:
            database.row_factory = lambda cursor, row: {
                column[0]: value for column, value in zip(cursor.description, row, strict=True)
            }
            yield database
    except sqlite3.Error as error:
        raise ImageError(f"{path}: {error}; move it away and a new one begins.") from error


def read_history(folder: Path, method: str) -> list[Entry]:
    """The versions of a method, each subject's from first to last."""
    if not (folder / "results.sqlite").is_file():
        raise ImageError(f"{folder}: no results.sqlite; `lighttree report` writes it.")
    with opened(folder) as database:
        rows = database.execute(
            "SELECT * FROM results WHERE rel_mse > 0 AND seconds_render > 0 ORDER BY started, seed"
        ).fetchall()
    methods = sorted({row["method"] for row in rows})
    if method not in methods:
        found = ", ".join(methods) or "nothing measured"
        raise ImageError(f"{folder}: no '{method}' in results.sqlite, only {found}.")
    entries = []
    of_method = [row for row in rows if row["method"] == method]
    for row in of_method:
        row["subject"] = tuple(row[name] for name in SUBJECT)
    for subject, of_subject in group_by(of_method, "subject").items():
        before: Rows = []
        for renderer, seeds in group_by(of_subject, "renderer").items():
            entries.append(
                Entry(
                    dict(zip(SUBJECT, subject, strict=True)),
                    renderer,
                    seeds[0]["started"],
                    spread([*cost_by_seed(seeds).values()]),
                    len(seeds),
                    confidence_interval([(seeds, before)]) if before else None,
                )
            )
            before = seeds
    return entries


def build_table(entries: list[Entry], method: str) -> Table:
    """The history as `lighttree history` prints it."""
    table = Table(
        *("Scene", "Budget", "Version", "First seen", "Rel. MSE x s", "Single seeds"),
        "Against the version before",
        title=f"{method}: relative MSE x seconds over versions; lower is better",
    )
    previous = None
    for entry in entries:
        is_first = entry.subject != previous
        previous = entry.subject
        cost, scene = entry.cost, entry.subject["scene"] if is_first else ""
        table.add_row(
            scene,
            format_budget(entry.subject["budget"]) if is_first else "",
            entry.renderer,
            entry.started,
            f"{cost.mean:.3g}",
            f"{cost.low:.3g} to {cost.high:.3g}" if entry.num_seeds > 1 else "one seed",
            "" if is_first else tell_change(entry),
            style="bold red" if entry.is_worse else None,
        )
    return table


def tell_change(entry: Entry) -> str:
    """How a version compares with the one before it, in words."""
    if entry.against is None:
        return "not known: it takes two seeds of both"
    mean, low, high = entry.against
    if entry.is_worse:
        return f"WORSE: {1 / mean:.2f} times the error (95 %: {1 / high:.2f} to {1 / low:.2f})"
    if low > 1:
        return f"better: {mean:.2f} times less error (95 %: {low:.2f} to {high:.2f})"
    return f"the same within its spread (95 %: {1 / high:.2f} to {1 / low:.2f} times the error)"
