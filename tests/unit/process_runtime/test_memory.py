import platform
import subprocess
import sys

import pytest

if platform.libc_ver()[0] != "glibc":
    pytest.skip("only glibc keeps freed memory and can be told not to", allow_module_level=True)

PROGRAM = """
import psutil
from process_runtime.memory import give_back_freed_memory
size = lambda: psutil.Process().memory_info().rss >> 20
blocks = [b"x" * 60_000 for _ in range(2_000)]
del blocks[:-1]  # what is still used lies behind what is free
before = size()
give_back_freed_memory()
print(before, size())
"""


def test_what_is_free_but_lies_before_what_is_used_is_given_back() -> None:
    """Some 115 MB were used; a heap shrinks by itself only from its end."""
    said = subprocess.run(
        [sys.executable, "-I", "-c", PROGRAM], capture_output=True, text=True, check=True
    ).stdout
    before_mb, after_mb = map(int, said.split())
    assert before_mb > 100
    assert after_mb < before_mb - 90
