"""Kernels are cached on disk by all they depend on, and tables reach them whole."""

import os
import subprocess
import sys
import time
from typing import NamedTuple

import numba
import numpy as np
import platformdirs
import pytest

from lighttree_core.jit import (
    allocating_kernel,
    called_kernel,
    f32,
    f64,
    flag,
    i32,
    i64,
    kernel,
    table,
)
from lighttree_core.jit import cache as kernel_cache

needs_compiler = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

KERNELS = """
from lighttree_core.jit import called_kernel, kernel
from other_kernels import double

@kernel
def read(a, i):
    return a[i]

@called_kernel
def triple(x):
    return 3 * x

@kernel
def use(x):
    return double(x) + triple(x)

@kernel
def alone(x):
    return x + 1
"""
OTHER_KERNELS = """
from lighttree_core.jit import kernel

@kernel
def double(x):
    return 2 * x
"""
USE = """
import logging
import numpy as np
from numba.core import event
logging.basicConfig(format="%(message)s")
compiled = []

class Listener(event.Listener):
    def on_start(self, event):
        pass
    def on_end(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)

event.register("numba:compile", Listener())
from some_kernels import alone, read, use
print(use(7), alone(1))
try:
    read(np.zeros(2), 5)
    print("unchecked")
except IndexError:
    print("checked")
print(*sorted(compiled))
"""


@pytest.fixture
def run(tmp_path):
    """Uses the kernels above in a process of its own; the lines it prints, and its warnings."""
    (tmp_path / "some_kernels.py").write_text(KERNELS)
    (tmp_path / "other_kernels.py").write_text(OTHER_KERNELS)

    def run(script=USE, **changes):
        environment = {
            **os.environ,
            "XDG_CACHE_HOME": str(tmp_path / "cache"),
            "LOCALAPPDATA": str(tmp_path / "cache"),
            "HOME": str(tmp_path),
            "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]),
            "NUMBA_DISABLE_JIT": "0",
            "NUMBA_BOUNDSCHECK": "0",
        } | changes
        environment = {name: value for name, value in environment.items() if value is not None}
        told = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True
        )
        assert told.returncode == 0, told.stderr
        return told.stdout.splitlines(), told.stderr

    return run


@needs_compiler
def test_kernels_are_compiled_once_and_bounds_checked_when_asked_for(run):
    (values, bounds, compiled), _ = run()
    assert (values, bounds) == ("35 2", "unchecked")
    assert compiled.split() == ["alone", "double", "read", "triple", "use"]
    assert run()[0] == ["35 2", "unchecked", ""]
    assert run(NUMBA_BOUNDSCHECK="1")[0][:2] == ["35 2", "checked"]
    assert run()[0] == ["35 2", "unchecked", ""]


@needs_compiler
def test_an_edit_compiles_anew_what_can_see_it_and_nothing_else(run, tmp_path):
    run()
    (tmp_path / "other_kernels.py").write_text(OTHER_KERNELS.replace("2 * x", "5 * x"))
    # All of one file count as one: they have the same imports.
    (values, _, compiled), _ = run()
    assert values == "56 2" and "use" in compiled and "double" in compiled
    (tmp_path / "some_kernels.py").write_text(KERNELS.replace("x + 1", "x + 2"))
    (values, _, compiled), _ = run()
    assert values == "56 3" and "alone" in compiled and "double" not in compiled


@needs_compiler
def test_a_damaged_file_is_compiled_again_and_told_once(run, tmp_path):
    run()
    files = list((tmp_path / "cache").rglob("*.kernel"))
    assert len(files) == 5
    for file in files:
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(data)
    files[0].write_bytes(b"")
    (values, _, compiled), warnings = run()
    assert values == "35 2" and len(compiled.split()) == 5
    assert warnings.count("is damaged") == 5
    assert run()[0] == ["35 2", "unchecked", ""]


@needs_compiler
def test_a_lost_file_of_what_a_kernel_calls_is_compiled_again(run, tmp_path):
    run()
    first_values = run()[0][0]
    for lost in ({"triple"}, {"double", "use"}):  # without `use`, nothing needs `double`
        for file in (tmp_path / "cache").rglob("*.kernel"):
            if file.name.split("-")[0].rpartition(".")[2] in lost:
                file.unlink()
        # In another process numba counts its functions otherwise.
        script = "from lighttree_core.vec import dot; dot((1.0,) * 3, (2.0,) * 3)\n" + USE
        values, _, compiled = run(script)[0]
        assert values == first_values and lost <= set(compiled.split())
        assert run()[0] == [first_values, "unchecked", ""]


@needs_compiler
def test_without_a_folder_kernels_are_compiled_in_memory_and_that_is_told_once(run, tmp_path):
    (tmp_path / "file").write_text("")
    folder = str(tmp_path / "file" / "cache")
    (values, _, compiled), warnings = run(XDG_CACHE_HOME=folder, LOCALAPPDATA=folder)
    assert values == "35 2" and len(compiled.split()) == 5
    assert warnings.count("cannot be kept") == 1


def test_a_user_without_a_home_has_no_folder(monkeypatch, caplog):
    def unknown(*_, **options):
        raise RuntimeError("could not determine the home directory")

    for told in (unknown, lambda *_, **options: "~/.cache/lighttree"):
        monkeypatch.setattr(platformdirs, "user_cache_dir", told)
        caplog.clear()
        assert kernel_cache.cache_folder.__wrapped__() is None
        assert caplog.text.count("cannot be kept") == 1


@needs_compiler
def test_a_full_disk_is_told_once(monkeypatch, caplog):
    def write(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kernel_cache, "_write", write)
    kernel_cache._warn_unwritable.cache_clear()

    def adds(number):
        return kernel(lambda x: x + number)

    assert (adds(1)(5), adds(2)(5)) == (6, 7)
    assert caplog.text.count("No space left on device") == 1


def test_installed_modules_count_by_their_versions_alone():
    assert kernel_cache._is_own("lighttree_core.vec") and kernel_cache._is_own(__name__)
    for name in ("numpy", "numba.core.types", "json", "numpy._core._multiarray_umath", "no.module"):
        assert not kernel_cache._is_own(name)


@needs_compiler
def test_old_kernels_are_removed_and_so_is_what_is_too_much(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(kernel_cache, "MAX_BYTES", 1000)
    now = time.time()
    for days, size in ((0, 400), (1, 400), (2, 400), (40, 10)):
        path = tmp_path / f"used-{days}-days-ago.kernel"
        path.write_bytes(bytes(size))
        os.utime(path, (now - 86400 * days,) * 2)
    kernel_cache.remove_old_kernels()
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["used-0-days-ago.kernel", "used-1-days-ago.kernel"]


@table
class Inner(NamedTuple):
    """A table in a table."""

    numbers: f64[:, ::1]


@table
class Outer(NamedTuple):
    """All that a table may hold."""

    on: flag
    small: f32
    large: f64
    count: i64
    rows: i32[::1]
    inner: Inner
    bits: flag[::1]


@kernel
def read_all(outer, row):
    """What a kernel finds in a table."""
    total = outer.small + outer.large + outer.count + outer.rows[row] + len(outer.rows)
    total += outer.inner.numbers[row, 1] + outer.inner.numbers.shape[1] + outer.bits[row]
    return total if outer.on else -1.0


@called_kernel
def write(outer, value):
    """Arrays of tables are written in place."""
    outer.rows[:] = value


@allocating_kernel
def square_rows(outer):
    """A kernel that allocates calls one that does not."""
    write(outer, 3)
    return outer.rows**2


def make_outer(on=True):
    rng = np.random.default_rng(7)
    inner = Inner(np.asfortranarray(rng.random((4, 3))))
    return Outer(on, 0.5, 2, 2**40, [1, 2, 3, 4], inner, bits=[True, False, True, False])


def test_a_table_reaches_kernels_whole():
    outer = make_outer()
    expected = 0.5 + 2 + 2**40 + 3 + 4 + outer.inner.numbers[2, 1] + 3 + 1
    assert read_all(outer, 2) == pytest.approx(expected, rel=1e-15)
    assert read_all(outer._replace(on=False), 2) == -1
    assert list(square_rows(outer)) == [9] * 4 and list(outer.rows) == [3] * 4


def test_a_table_has_exact_types():
    outer = make_outer()
    assert outer.rows.dtype == np.int32 and outer.inner.numbers.flags.c_contiguous
    assert type(outer.small) is np.float32
    rows = np.zeros(2, np.int32)
    assert outer._replace(rows=rows).rows is rows
    with pytest.raises(TypeError, match="expected an array of 1 dimensions, not 2"):
        outer._replace(rows=np.zeros((2, 2)))
    with pytest.raises(TypeError, match="expected a Inner, not Outer"):
        outer._replace(inner=outer)


@needs_compiler
def test_kernels_of_two_tables_are_told_apart_by_their_fields():
    assert Inner.table_type != Outer.table_type
    paths = [
        read_all.for_python._cache._path(types) for types in (Inner.table_type, Outer.table_type)
    ]
    assert paths[0] != paths[1]
