"""The library of compiled kernels: one shared object, compiled ahead of time by numba's `pycc`.

A wheel ships it for the processors of `SHIPPED`. `clustermcl.jobs.build_kernels` builds it for this
processor where numba and a C compiler are. All processes map the same file, whose name has a digest
of all that the machine code depends on.
"""

import importlib.machinery
import importlib.util
import os
import platform
import sys
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

from clustermcl.filter.kernels.folders import is_usable, remarks, user_folder, why_untrusted

Entries: TypeAlias = dict[str, tuple[Callable[..., Any], tuple[Any, ...]]]
"""By name in the library: a kernel's Python function, and numba's types of its arguments."""

MODULE = "clustermcl_kernels"
DIGEST_BYTES = 32
"""Length of the SHA-256 at the end of the file, of all before it."""
SHIPPED = {
    "x86_64": {"x86-64-v3": frozenset({"avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"}),
               "x86-64": frozenset[str]()},
    "aarch64": {"generic": frozenset[str]()},
}  # fmt: skip
"""By machine: the processors that a wheel has a library for, and the instructions these need."""
_FILTER = Path(__file__).parents[1]


class NoKernelsError(ImportError):
    """There are no compiled kernels, and no numba that compiles them."""

    def __init__(self) -> None:
        super().__init__(
            "there are no compiled kernels for this Python and processor, and numba, which "
            "compiles them, is not installed: pip install 'clustermcl[compile]'"
        )


@cache
def library() -> ModuleType | None:
    """Return the library, loaded; None: it is not on disk or damaged.

    After it was built, `library.cache_clear()` has it looked for again.
    """
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        return None
    present = _instructions()
    shipped = (
        shipped_file(processor)
        for processor, needed in SHIPPED.get(platform.machine(), {}).items()
        if needed <= present
    )
    loaded = (_loaded(file) for file in (path(), *shipped) if file.exists())
    return next((module for module in loaded if module), None)


def _loaded(file: Path) -> ModuleType | None:
    if problem := why_untrusted(file.parent) or why_untrusted(file):
        remarks[f"the library of kernels is not loaded: {problem}"] = None
        return None
    if not _is_whole(file):
        return None
    loader = importlib.machinery.ExtensionFileLoader(MODULE, str(file))
    spec = importlib.util.spec_from_loader(MODULE, loader)
    assert spec is not None  # the loader is one of files
    try:
        return importlib.util.module_from_spec(spec)
    except ImportError:
        return None


def _is_whole(file: Path) -> bool:
    """Whether the file ends with the digest of the rest: half a library ends the process."""
    try:
        content = file.read_bytes()
    except OSError:
        return False
    return sha256(content[:-DIGEST_BYTES]).digest() == content[-DIGEST_BYTES:]


def path() -> Path:
    """Return where the library of these sources, for this Python and processor, is on disk.

    In the folder ``NUMBA_CACHE_DIR``, or else the package's; or else, if it is not there and that
    folder cannot be written, the user's.
    """
    machine = sys.version + platform.machine() + " ".join(sorted(_instructions()))
    file = f"kernels-{_digest_with(machine)}.so"
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named and is_usable(Path(named, file), "NUMBA_CACHE_DIR"):
        return Path(named, file)
    if (own := _FILTER / "__pycache__" / file).exists() or os.access(_FILTER, os.W_OK):
        return own
    return user_folder("kernels") / file


def shipped_file(processor: str) -> Path:
    """Return where a wheel for this release of Python has the library for a kind of processor."""
    release = sys.implementation.cache_tag
    return _FILTER / "kernels" / f"kernels-{_digest_with(release)}-{processor}.so"


def _digest_with(machine: str) -> str:
    """Return a digest of the sources, and of what else the machine code depends on."""
    digest = sha256(machine.encode())
    for source in sorted(_FILTER.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _instructions() -> frozenset[str]:
    """Return the names that /proc/cpuinfo has for the first processor's instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text("ascii", "replace").splitlines()
    except OSError:
        lines = []
    named = (line for line in lines if line.startswith(("flags", "Features")))
    return frozenset(next(named, "").partition(":")[2].split())
