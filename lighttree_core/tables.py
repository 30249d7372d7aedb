"""Tables of `scene.py` as kernels take them: the same columns, of exact types."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields

import numpy as np


def column_tuple(name: str, table: type, module: str) -> type:
    """A named tuple with the columns of a dataclass of arrays; module: the one it is kept in."""
    return namedtuple(name, [column.name for column in fields(table)], module=module)


def exact_columns(kind: type, table, empty):
    """A table as a tuple of that kind, contiguous and of the types of an empty one."""
    return kind(
        *(
            np.ascontiguousarray(getattr(table, name), getattr(empty, name).dtype)
            for name in kind._fields
        )
    )
