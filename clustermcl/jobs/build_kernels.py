"""Compiles the library of kernels: a process of its own, because numba stays in a process.

It calls every kernel as plain Python, so that the types of arguments are known, and then
compiles them all ahead of time.
"""

import argparse
import platform
import shutil
import tempfile
from hashlib import sha256
from pathlib import Path

from numba.core.compiler import Flags
from numba.pycc import CC, compiler

from clustermcl.filter.kernels import compiled as kernels
from clustermcl.filter.kernels import library as kernel_library
from clustermcl.filter.settings import MotionSettings, SensorSettings
from clustermcl.jobs.warm_up import run_kernels
from clustermcl.runtime.parent import die_with_parent_if_asked

_PART = ".part"


def build(file: Path, processor: str) -> None:
    """Compile the kernels for a kind of processor; the file is written whole or not at all.

    Raises:
        Exception: of pycc: RuntimeError where there is no C compiler, or any other.
        OSError: the file cannot be written.
    """

    def flags() -> Flags:
        chosen = Flags()
        chosen.error_model = "numpy"  # as `Kernel.by_numba`; pycc has no option for it
        return chosen

    compiler.Flags = flags
    for left in file.parent.glob(f"*{_PART}"):  # by a killed process: the caller has the lock
        shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=file.parent, suffix=_PART) as folder:
        library = CC(kernel_library.MODULE, source_module=__name__)
        library.output_dir, library.output_file = folder, file.name
        library.target_cpu = processor
        for name, (function, types) in kernels.called_in(_run_every_kernel).items():
            library.export(name, types)(function)
        library.compile()
        compiled = Path(folder) / file.name
        with compiled.open("ab") as out:
            out.write(sha256(compiled.read_bytes()).digest())
        compiled.rename(file)


def _run_every_kernel() -> None:
    run_kernels(SensorSettings(), MotionSettings())
    run_kernels(SensorSettings(), MotionSettings(model="differential"))


def _library_file(text: str) -> Path:
    file = Path(text)
    if file.suffix != ".so" or file.is_dir() or not file.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is no .so file in a folder that exists")
    return file


if __name__ == "__main__":
    die_with_parent_if_asked()
    about = "Compile the kernels ahead of time ('clustermcl warm-up' does so for this machine)."
    parser = argparse.ArgumentParser("build_kernels", description=about, allow_abbrev=False)
    parser.add_argument("file", type=_library_file, help="file to write, FOLDER/NAME.so")
    known = ["host", *kernel_library.SHIPPED.get(platform.machine(), {})]
    of_whom = "kind of processor (default: this machine's)"
    parser.add_argument("processor", nargs="?", default="host", choices=known, help=of_whom)
    given = parser.parse_args()
    build(given.file, given.processor)
