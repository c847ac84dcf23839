"""The worker process on a machine that seems to have four cores; idle workers end soon."""

import os

from clustermcl.runtime.supervisor import ChildCount, use_one_thread_for_arithmetic

IDLE_S = 2.0


def four_cores(_pid: int) -> set[int]:
    return set(range(4))


if __name__ == "__main__":
    os.sched_getaffinity = four_cores  # type: ignore[assignment]
    ChildCount.__init__.__defaults__ = (IDLE_S,)  # type: ignore[misc]
    use_one_thread_for_arithmetic()  # before numpy is imported
    from clustermcl.worker.process import main

    main()
