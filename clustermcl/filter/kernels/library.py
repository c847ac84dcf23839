"""The library of compiled kernels: one shared object, compiled ahead of time by numba's `pycc`.

`clustermcl.jobs.build_kernels` builds it where there is a C compiler; then all processes map the
same file. Its name has a digest of all that the machine code depends on.
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


def entry(name: str) -> Callable[..., Any] | None:
    """Return a compiled kernel by its name in the library; None: there is none."""
    found: Callable[..., Any] | None = getattr(library(), name, None)
    return found


@cache
def library() -> ModuleType | None:
    """Return the library, loaded; None: it is not on disk or damaged.

    After it was built, `library.cache_clear()` has it looked for again.
    """
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        return None
    file = path()
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
    here = Path(__file__).parents[1]
    digest = sha256(sys.version.encode() + _processor())
    for source in sorted(here.rglob("*.py")):
        digest.update(source.read_bytes())
    file = f"kernels-{digest.hexdigest()[:16]}.so"
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named and is_usable(Path(named, file), "NUMBA_CACHE_DIR"):
        return Path(named, file)
    if (own := here / "__pycache__" / file).exists() or os.access(here, os.W_OK):
        return own
    return user_folder("kernels") / file


def trusted_folder() -> Path:
    """Return the folder of `path`, where numba's files, which name code to run, are as well.

    Raises:
        PermissionError: others may have changed it.
    """
    folder = path().parent
    if problem := why_untrusted(folder):
        raise PermissionError(problem)
    return folder


def _processor() -> bytes:
    """Return the line of /proc/cpuinfo that names the first processor's instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_bytes().splitlines()
    except OSError:
        lines = []
    instructions = (line for line in lines if line.startswith((b"flags", b"Features")))
    return next(instructions, platform.machine().encode())
