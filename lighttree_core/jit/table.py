"""Tables: named tuples of arrays and numbers, which kernels get as one pointer.

numba passes a named tuple field by field, and a world of a hundred arrays as seven hundred numbers,
through every call. A table is laid out once as a list of eight-byte words that never changes, so a
kernel takes its address and loads what it needs. Its fields have exact types, so every scene runs
the same kernels.

A number is one word, a table within a table is its address, and an array is its size, its address,
its shape and its strides.
"""

import hashlib
from typing import get_type_hints

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

f32, f64, i32, i64, u8, flag = (
    types.float32,
    types.float64,
    types.int32,
    types.int64,
    types.uint8,
    types.boolean,
)

WORD = ir.IntType(64)
_DTYPES = {f32: np.float32, f64: np.float64, i32: np.int32, i64: np.int64, u8: np.uint8, flag: bool}


class TableType(types.Type):
    """What numba knows of a table: the class of named tuples, and the types of its fields."""

    def __init__(self, kind: type, fields: dict[str, types.Type]):
        self.kind, self.fields = kind, fields
        self.offsets, self.num_words = {}, 0
        for name, field in fields.items():
            self.offsets[name] = self.num_words
            self.num_words += 2 + 2 * field.ndim if isinstance(field, types.Array) else 1
        # Kernels are cached by the names of their arguments' types: another layout, another name.
        layout = ", ".join(f"{name}: {field}" for name, field in fields.items())
        digest = hashlib.sha256(layout.encode()).hexdigest()[:8]
        super().__init__(name=f"Table({kind.__name__}_{digest})")

    @property
    def mangling_args(self):
        return self.name, ()


class TablePointer(type(WORD.as_pointer())):
    """LLVM's type of a pointer to the words of a table."""

    def __init__(self, num_words: int):
        super().__init__(WORD)
        self.num_bytes = 8 * num_words


def describe_tables(function: ir.Function) -> None:
    """Tell LLVM that what a function gets as tables may be loaded from at any time."""
    for argument in function.args:
        if isinstance(argument.type, TablePointer):
            argument.attributes.dereferenceable = argument.type.num_bytes
            argument.attributes.align = 8


@register_model(TableType)
class _TableModel(models.PrimitiveModel):
    def __init__(self, manager, table_type):
        super().__init__(manager, table_type, TablePointer(table_type.num_words))


def table(kind: type) -> type:
    """Make a table of a NamedTuple whose fields are annotated with types such as `f32[:, ::1]`.

    Values are brought to exactly these types, arrays without a copy where they have them already.
    """
    hints = get_type_hints(kind)
    fields = {name: getattr(hint, "table_type", hint) for name, hint in hints.items()}
    table_type = TableType(kind, fields)

    class Exact(kind):
        def __new__(cls, *args, **kwargs):
            given = kind(*args, **kwargs)
            values = map(_exact, fields.values(), given)
            return tuple.__new__(cls, values)

        @classmethod
        def _make(cls, values):
            return cls(*values)

        @property
        def address(self) -> int:
            """Where the words lie; they live as long as the table."""
            words = self.__dict__.get("_words")
            if words is None:
                words = self.__dict__["_words"] = _lay_out(self)
            return words.ctypes.data

        def __reduce__(self):
            return type(self), tuple(self)

    for name in ("__name__", "__qualname__", "__doc__", "__module__"):
        setattr(Exact, name, getattr(kind, name))
    Exact.table_type = table_type
    typeof_impl.register(Exact)(lambda value, context: table_type)
    return Exact


def _exact(field: types.Type, value):
    """A value as a field of this type holds it."""
    if isinstance(field, TableType):
        if getattr(type(value), "table_type", None) is not field:
            raise TypeError(f"expected a {field.kind.__name__}, not {type(value).__name__}")
        return value
    if not isinstance(field, types.Array):
        return _DTYPES[field](value)
    array = np.ascontiguousarray(value, _DTYPES[field.dtype])
    if array.ndim != field.ndim:
        raise TypeError(f"expected an array of {field.ndim} dimensions, not {array.ndim}")
    return array


def _lay_out(values) -> np.ndarray:
    """The words of a table."""
    words = []
    for value in values:
        if isinstance(value, np.ndarray):
            address = value.__array_interface__["data"][0]
            words += [value.size, address, *value.shape, *value.strides]
        elif isinstance(value, tuple):
            words.append(value.address)
        else:
            number = np.zeros(8, np.uint8)
            raw = np.asarray(value)
            number[: raw.nbytes] = np.frombuffer(raw.tobytes(), np.uint8)
            words.append(int(number.view(np.int64)[0]))
    return np.array(words, np.int64)


@unbox(TableType)
def _unbox_table(table_type, value, context):
    address = context.pyapi.object_getattr_string(value, "address")
    number = context.pyapi.long_as_longlong(address)
    context.pyapi.decref(address)
    is_error = cgutils.is_not_null(context.builder, context.pyapi.err_occurred())
    pointer = context.builder.inttoptr(number, WORD.as_pointer())
    return NativeValue(pointer, is_error=is_error)


@infer_getattr
class _TableFields(AttributeTemplate):
    key = TableType

    def generic_resolve(self, table_type, name):
        return table_type.fields.get(name)


def _load(builder, pointer, word: int, kind=WORD):
    """What a word of a table holds; it never changes, so it may be loaded once and early."""
    address = builder.gep(pointer, [WORD(word)])
    value = builder.load(builder.bitcast(address, kind.as_pointer()))
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


@lower_getattr_generic(TableType)
def _load_field(context, builder, table_type, pointer, name):
    field, word = table_type.fields[name], table_type.offsets[name]
    if isinstance(field, types.Array):
        return _load_array(context, builder, field, pointer, word)
    if isinstance(field, TableType):
        inner = _load(builder, pointer, word, WORD.as_pointer())
        for fact, number in (("dereferenceable", 8 * field.num_words), ("align", 8)):
            inner.set_metadata(fact, builder.module.add_metadata([WORD(number)]))
        return inner
    raw = _load(builder, pointer, word, context.get_data_type(field))
    return context.data_model_manager[field].from_data(builder, raw)


def _load_array(context, builder, field, pointer, word):
    array = cgutils.create_struct_proxy(field)(context, builder)
    item = context.get_data_type(field.dtype)
    array.meminfo = ir.Constant(array.meminfo.type, None)
    array.parent = ir.Constant(array.parent.type, None)
    array.nitems = _load(builder, pointer, word)
    array.itemsize = WORD(context.get_abi_sizeof(item))
    array.data = _load(builder, pointer, word + 1, item.as_pointer())
    axes = range(field.ndim)
    shape = [_load(builder, pointer, word + 2 + axis) for axis in axes]
    strides = [_load(builder, pointer, word + 2 + field.ndim + axis) for axis in axes]
    array.shape = cgutils.pack_array(builder, shape)
    array.strides = cgutils.pack_array(builder, strides)
    return array._getvalue()
