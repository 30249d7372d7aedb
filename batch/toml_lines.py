"""The line of each key in a TOML file, which Python's own parser does not tell.

The file was parsed before, so all that is left to do is to skip its values and to count lines.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable

Where = tuple[str | int, ...]  # ("scene", 1, "files"): `files` of the second [[scene]]

NAME = r"""(?:"(?:\\.|[^"\\\n])*"|'[^'\n]*'|[\w-]+)"""
KEY = rf"{NAME}(?:[ \t]*\.[ \t]*{NAME})*"
STRING = r'''"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:\\.|[^"\\\n])*"|'[^'\n]*\''''
STATEMENT = re.compile(rf"\s*(?:#[^\n]*\n|(\[\[?)[ \t]*({KEY})[ \t]*\]\]?|({KEY})[ \t]*=)?")
VALUE = re.compile(rf"({STRING})|#[^\n]*|([\[{{])|([\]}}])|(\n)|[^\"'#\[\]{{}}\n]+", re.DOTALL)


def find_lines(text: str) -> dict[Where, int]:
    """The line of every table and key in a valid TOML file; inside inline tables, of none."""
    lines: dict[Where, int] = {}
    counts: dict[Where, int] = {}  # of the tables in each array of tables
    table: Where = ()
    text = text.replace("\r\n", "\n") + "\n"
    position = 0
    while statement := STATEMENT.match(text, position):
        if statement.end() == position:
            break
        position = statement.end()
        brackets, header, key = statement.groups()
        if brackets:
            *around, last = _split_key(header)
            table = _enter(counts, (), around)
            if brackets == "[[":
                counts[*table, last] = counts.get((*table, last), 0) + 1
            table = _enter(counts, table, [last])
            lines.setdefault(table, text.count("\n", 0, statement.start(2)) + 1)
        elif key:
            where, line = table, text.count("\n", 0, statement.start(3)) + 1
            for part in _split_key(key):
                where = *where, part
                lines.setdefault(where, line)
            position = _skip_value(text, position)
    return lines


def _split_key(key: str) -> list[str]:
    """The parts of a dotted key, without their quotes."""
    parts, table = [], tomllib.loads(f"{key} = 0")
    while table:
        ((part, table),) = table.items()
        parts.append(part)
    return parts


def _enter(counts: dict[Where, int], table: Where, parts: Iterable[str]) -> Where:
    """Go down a header's keys; an array of tables means its last one."""
    for part in parts:
        table = *table, part
        if table in counts:
            table = *table, counts[table] - 1
    return table


def _skip_value(text: str, position: int) -> int:
    """The end of the value that begins here, which brackets carry over the end of its line."""
    depth = 0
    while token := VALUE.match(text, position):
        position = token.end()
        _, opening, closing, newline = token.groups()
        depth += bool(opening) - bool(closing)
        if newline and depth == 0:
            break
    return position
