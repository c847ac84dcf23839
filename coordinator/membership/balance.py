"""How jobs are spread over workers: as evenly as can be, and with as few moves."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Move:
    """A job gets another worker."""

    job_id: str
    worker: str


def balanced(
    jobs: Mapping[str | None, Collection[str]],
    workers: Collection[str],
    may_move: Callable[[str], bool],
) -> list[Move]:
    """Give each job that waits to the least loaded worker, then even out.

    A job moves only from a worker that has two more than another: else it would soon move back.
    Of equally loaded workers, the first by name gets a job and the last by name gives one away.

    Args:
        jobs: each worker's jobs by id; those of None wait for a worker.
        workers: who may get jobs; jobs of others stay where they are.
        may_move: whether a job may change hands while its worker is well.
    """
    if not workers:
        return []
    load = {worker: len(jobs.get(worker, ())) for worker in workers}
    moves = []

    def give(job_id: str) -> None:
        least = min(load, key=lambda name: (load[name], name))
        load[least] += 1
        moves.append(Move(job_id, least))

    for job_id in sorted(jobs.get(None, ())):
        give(job_id)
    movable: dict[str, list[str]] = {}
    while max(load.values()) - min(load.values()) >= 2:
        most = max(load, key=lambda name: (load[name], name))
        if most not in movable:
            movable[most] = sorted(filter(may_move, jobs[most]))
        if not movable[most]:
            break
        load[most] -= 1
        give(movable[most].pop(0))
    return moves
