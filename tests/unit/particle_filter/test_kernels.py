"""The door to compiled code."""

import importlib
import os
import sys
from pathlib import Path

import pytest

LIBRARY = """
from particle_filter.kernels import kernel

@kernel
def one() -> float:
    return {value}
"""
PROGRAM = """
from particle_filter.kernels import kernel
from {library} import one

@kernel
def two() -> float:
    return 2.0 * one()
"""


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled")
def test_machine_code_on_disk_is_not_used_when_a_callee_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library, program = "kernel_that_changes", "kernel_that_calls_it"
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / f"{program}.py").write_text(PROGRAM.format(library=library))
    answers = []
    for value in (1.0, 10.0):
        (tmp_path / f"{library}.py").write_text(LIBRARY.format(value=value))
        importlib.invalidate_caches()
        for name in (library, program):
            sys.modules.pop(name, None)
        answers.append(importlib.import_module(program).two())
    for name in (library, program):
        del sys.modules[name]
    assert answers == [2.0, 20.0]
