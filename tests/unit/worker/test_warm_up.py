import logging
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from clustermcl.filter.kernels import library as kernel_library
from clustermcl.filter.kernels.folders import remarks
from clustermcl.filter.settings import MotionSettings, SensorSettings
from clustermcl.jobs.warm_up import compile_kernels, run_kernels
from clustermcl.runtime.supervisor import python_module
from tests.unit.programs import ran

needs_compiler = pytest.mark.skipif(
    not shutil.which(os.environ.get("CC", "cc")), reason="there is no C compiler"
)


DRIVE = """
import sys
from clustermcl.commands.command import app
app(["evaluate", "sim:cross_tags", "--steps", "40", "--jobs", "1"], standalone_mode=False)
print("imported:", sorted({"numba", "llvmlite"} & set(sys.modules)))
"""


@needs_compiler
def test_a_robot_drives_without_numba() -> None:
    assert ran(DRIVE, timeout_s=250.0).stdout.splitlines()[-1] == "imported: []"


@pytest.fixture
def built_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The library of kernels, while another folder is set that has none."""
    compile_kernels(SensorSettings())
    run_kernels(SensorSettings(), MotionSettings())
    built = kernel_library.path()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kernel_library.library.cache_clear()
    yield built
    kernel_library.library.cache_clear()


@pytest.mark.usefixtures("built_before")
def test_without_a_compiler_one_line_says_what_it_costs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("CC", "false")
    with caplog.at_level(logging.WARNING):
        compile_kernels(SensorSettings())
    (line,) = caplog.messages
    assert line.startswith("no library of kernels can be built")
    assert not list(tmp_path.glob("kernels-*.so"))


@needs_compiler
@pytest.mark.parametrize("kept", [0, 3000, 500_000])
def test_half_a_library_of_kernels_is_not_loaded(built_before: Path, kept: int) -> None:
    content = built_before.read_bytes()
    for part, is_loaded in ((content[:kept], False), (content, True)):
        kernel_library.path().write_bytes(part)
        kernel_library.library.cache_clear()
        assert (kernel_library.library() is not None) is is_loaded


@needs_compiler
@pytest.mark.parametrize("planted", ["file", "folder"])
def test_a_library_that_others_may_write_is_neither_loaded_nor_built(
    built_before: Path, planted: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = kernel_library.path()
    shutil.copyfile(built_before, file)
    (file if planted == "file" else tmp_path).chmod(0o777)
    assert kernel_library.library() is None
    assert f"is not loaded: other accounts may write {tmp_path}" in str(remarks)
    if planted == "folder":
        compile_kernels(SensorSettings())
        assert "some 20 s more: other accounts may write" in caplog.text


def test_a_user_who_may_not_write_the_package_has_a_library_of_his_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "relative")  # so it is not used
    (tmp_path / "relative").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kernel_library, "_FILTER", tmp_path / "installed")
    (tmp_path / "installed").mkdir()
    assert kernel_library.path().parent == tmp_path / "installed" / "__pycache__"
    before = kernel_library.path().name, kernel_library.shipped_file("x86-64").name
    (tmp_path / "installed" / "kernel.py").write_text("other sources")
    after = kernel_library.path().name, kernel_library.shipped_file("x86-64").name
    assert not {*before} & {*after}, "else old machine code would run"
    monkeypatch.setattr(os, "access", lambda _file, _mode: False)
    assert kernel_library.path().parent == tmp_path / "clustermcl" / "kernels"


@pytest.mark.parametrize("words", ["--help", "notes.txt", "none/a.so", "a.so pentium", ""])
def test_the_compiler_of_kernels_writes_no_file_that_is_no_library(
    words: str, tmp_path: Path
) -> None:
    command = [*python_module("clustermcl.jobs.build_kernels"), *words.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "usage: build_kernels" in (done.stderr or done.stdout)
    assert (done.returncode, list(tmp_path.iterdir())) == (0 if words == "--help" else 2, [])
