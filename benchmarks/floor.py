"""The kernels' work in C, compiled for this machine: how fast it can be done here."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_SOURCE = Path(__file__).with_name("floor.c")
COMMAND = ("cc", "-O3", "-march=native", "-shared", "-fPIC")


class NoCompilerError(RuntimeError):
    """This machine has no C compiler, so there is no floor to compare with."""


@cache
def library() -> ctypes.CDLL:
    """floor.c, compiled.

    Raises:
        NoCompilerError: there is no `cc`.
    """
    if shutil.which(COMMAND[0]) is None:
        raise NoCompilerError("no C compiler `cc`: install gcc or clang to compare with C")
    with tempfile.TemporaryDirectory() as folder:
        binary = Path(folder) / "floor.so"
        subprocess.run([*COMMAND, str(_SOURCE), "-o", str(binary), "-lm"], check=True)
        return ctypes.CDLL(str(binary))  # stays mapped without its file


def call(name: str, *arguments: object) -> Callable[[], None]:
    """A function of floor.c bound to arguments; arrays must be C-ordered and outlive it."""
    converted = [_converted(argument) for argument in arguments]
    function = getattr(library(), name)
    function.restype = None
    return lambda: function(*converted)


def _converted(argument: object) -> Any:
    match argument:
        case np.ndarray():
            assert argument.flags.c_contiguous
            return argument.ctypes.data_as(ctypes.c_void_p)
        case float():
            return ctypes.c_double(argument)
        case int():
            return ctypes.c_int64(argument)
    raise TypeError(f"floor.c takes arrays, floats and ints, not {type(argument).__name__}")
