import platform

import pytest

from clustermcl.runtime.memory import ARENAS
from tests.unit.programs import ran

if platform.libc_ver()[0] != "glibc":
    pytest.skip("only glibc keeps freed memory and can be told not to", allow_module_level=True)

PROGRAM = """
import psutil
from clustermcl.runtime.memory import trim_heap
size = lambda: psutil.Process().memory_info().rss >> 20
blocks = [b"x" * 60_000 for _ in range(2_000)]
del blocks[:-1]  # what is still used lies behind what is free
before = size()
trim_heap()
print(before, size())
"""


ARENAS_PROGRAM = """
import ctypes, sys, threading
from clustermcl.runtime.memory import share_arenas
if sys.argv[1] == "shared":
    share_arenas()
everybody = threading.Barrier(12)
def use():
    everybody.wait()
    kept = [ctypes.CDLL(None).malloc(5_000) for _ in range(200)]
    everybody.wait()
threads = [threading.Thread(target=use) for _ in range(12)]
for thread in threads: thread.start()
for thread in threads: thread.join()
libc = ctypes.CDLL(None)
libc.fdopen.restype = ctypes.c_void_p
stream = libc.fdopen(1, b"w")
libc.malloc_info(0, ctypes.c_void_p(stream))
libc.fflush(ctypes.c_void_p(stream))
"""


def arenas(word: str) -> int:
    return ran(ARENAS_PROGRAM, word).stdout.count("<heap nr=")


def test_threads_share_a_few_arenas() -> None:
    assert arenas("shared") <= ARENAS < arenas("by itself")


def test_free_memory_below_used_memory_is_returned() -> None:
    """Some 115 MB were used; a heap shrinks by itself only from its end."""
    before_mb, after_mb = map(int, ran(PROGRAM).stdout.split())
    assert before_mb > 100
    assert after_mb < before_mb - 90
