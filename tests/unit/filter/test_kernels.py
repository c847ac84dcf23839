import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[3]
compiled = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled"
)

LIBRARY = """
from clustermcl.filter.kernels.compiled import kernel

@kernel
def one() -> float:
    return {value}
"""
PROGRAM = """
from clustermcl.filter.kernels.compiled import kernel
from {library} import one

@kernel
def two() -> float:
    return 2.0 * one()
"""


@compiled
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


PRINT = """
from kernel_alone import one
from clustermcl.filter.kernels.compiled import cache_problems
print(one(), *cache_problems)
"""


FULL_DISK = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))  # no file may be longer: as a full disk
"""


def run_kernel(
    folder: Path, before: str = "", **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a kernel in a process of its own; it prints the answer, and what ails the cache."""
    (folder / "kernel_alone.py").write_text(LIBRARY.format(value=3.0))
    search = os.pathsep.join([str(REPOSITORY), str(folder)])
    return subprocess.run(
        [sys.executable, "-c", before + PRINT],
        env={**os.environ, "PYTHONPATH": search, **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@compiled
def test_without_a_cache_folder_a_kernel_is_compiled_and_the_reason_reported(
    tmp_path: Path,
) -> None:
    # Numba's locator for notebooks finds no place for a file, as none does on a read-only disk.
    ran = run_kernel(tmp_path, NUMBA_CACHE_LOCATOR_CLASSES="IPythonCacheLocator")
    assert (ran.stdout, ran.stderr) == ("3.0 no folder for them can be written\n", "")


@compiled
def test_a_full_disk_only_prevents_caching(tmp_path: Path) -> None:
    ran = run_kernel(tmp_path, FULL_DISK, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert (ran.stdout, ran.stderr) == ("3.0 [Errno 27] File too large\n", "")


@compiled
def test_a_kernel_whose_cache_file_is_damaged_is_compiled_again(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run_kernel(tmp_path, NUMBA_CACHE_DIR=str(cache)).stdout == "3.0\n"
    (index,) = cache.rglob("*.nbi")
    for content in (b"", b"\x00" * 64, b"cno_module_of_this_name\nname\n."):
        index.write_bytes(content)
        ran = run_kernel(tmp_path, NUMBA_CACHE_DIR=str(cache))
        assert ran.stdout.startswith("3.0 "), content
        assert ran.stderr == ""
