"""Kernels are cached on disk, but never in place of others that were asked for."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numba
import pytest

from lighttree_core import jit

KERNEL = """
from lighttree_core.jit import kernel

@kernel
def read(a, i):
    return a[i]
"""
USE = """
import numpy as np
from reads_a_table import read
try:
    read(np.zeros(2), 5)
    print("unchecked")
except IndexError:
    print("checked")
"""


def test_bounds_are_checked_when_asked_for_whatever_the_cache_holds(tmp_path):
    (tmp_path / "reads_a_table.py").write_text(KERNEL)
    environment = {
        **os.environ,
        "XDG_CACHE_HOME": str(tmp_path),
        "LOCALAPPDATA": str(tmp_path),
        "HOME": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]),
        "NUMBA_DISABLE_JIT": "0",
    }
    # The first run fills the cache, which the second one, of the other kind, must not take from.
    told = [
        subprocess.run(
            [sys.executable, "-c", USE],
            env={**environment, "NUMBA_BOUNDSCHECK": check},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for check in ("0", "1", "0")
    ]
    assert told == [["unchecked"], ["checked"], ["unchecked"]]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_threads_that_make_kernels_at_once_keep_to_our_folder():
    def make(i):
        return jit.Kernel(lambda x: x + i)

    before, interval = numba.config.CACHE_DIR, sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            kernels = list(pool.map(make, range(400)))
    finally:
        sys.setswitchinterval(interval)
    folders = {kernel.for_kernels._cache.cache_path for kernel in kernels}
    assert all(folder.startswith(str(jit.CACHE_FOLDER)) for folder in folders)
    assert before == numba.config.CACHE_DIR
