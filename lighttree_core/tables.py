"""Tables of `scene.py` as kernels take them: the same columns, of exact types."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numba

from .jit import table


def column_table(name: str, columns: type, module: str) -> type:
    """A table with the columns of a dataclass of arrays; module: the one it is kept in."""
    empty = columns.empty()
    types = []
    for column in fields(columns):
        array = getattr(empty, column.name)
        types.append(
            (
                column.name,
                numba.from_dtype(array.dtype)[
                    (slice(None),) * (array.ndim - 1) + (slice(None, None, 1),)
                ],
            )
        )
    kind = NamedTuple(name, types)
    kind.__module__ = module
    return table(kind)
