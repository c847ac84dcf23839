"""Record what clusters say of scans, and fit the evidence model to it.

python -m benchmarks.evidence_model record EXPERIMENT... --data DATA --out FOLDER
python -m benchmarks.evidence_model fit FOLDER
"""

import argparse
import time
from pathlib import Path

import msgspec

from benchmarks.evidence_model.fit import best_of, stacks_of, table
from benchmarks.evidence_model.models import families
from benchmarks.evidence_model.record import recorded
from benchmarks.evidence_model.records import save
from benchmarks.evidence_model.replay import Rules
from benchmarks.experiments.case import AfterStep, Case, RecordedRobot
from benchmarks.experiments.catalogue import all_cases
from clustermcl.commands.evaluate import start_steps
from clustermcl.evaluation.run import course_of
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.evidence_model", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    record = commands.add_parser("record")
    record.add_argument("experiments", nargs="+")
    record.add_argument("--data", type=Path, help="folder of recordings and maps")
    record.add_argument("--out", type=Path, required=True)
    record.add_argument("--name", help="of the file; left out: the experiment's")
    record.add_argument("--starts", type=int, default=8)
    record.add_argument("--steps", type=int, default=60)
    record.add_argument("--places", type=int, default=48)
    record.add_argument("--kidnap-at", type=int, help="lift a simulated robot after this step")
    record.add_argument("--first-seed", type=int, default=1000, help="of simulated robots")
    record.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    fit = commands.add_parser("fit")
    fit.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "fit":
        _fit(arguments.folder)
        return
    settings = load_settings(None, ["cluster.particles=1000", *arguments.set])
    cases = {case.name: case for case in all_cases(arguments.data)}
    for name in arguments.experiments:
        _record(cases[name], settings, arguments)


def _record(case: Case, settings: Settings, arguments: argparse.Namespace) -> None:
    begun = time.process_time()
    if arguments.kidnap_at is not None:
        robot = msgspec.structs.replace(case.robot, kidnapping=AfterStep(arguments.kidnap_at))
        case = msgspec.structs.replace(case, robot=robot)
    case = msgspec.structs.replace(case, updates=None)
    first = arguments.first_seed
    if isinstance(case.robot, RecordedRobot):
        count = sum(1 for _ in course_of(case, 0, settings.bridge).steps)
        runs = [(first, s) for s in start_steps(count, arguments.starts, arguments.steps)]
    else:
        runs = [(first + index, 0) for index in range(arguments.starts)]
    records = [
        recorded(case, seed, start, arguments.steps, arguments.places, settings)
        for seed, start in runs
    ]
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / f"{arguments.name or case.name}.npz"
    save(records, file)
    print(f"{file}: {len(records)} runs, {time.process_time() - begun:.0f} s", flush=True)


def _fit(folder: Path) -> None:
    stacks = stacks_of(folder)
    print("| model | log score | sure and wrong, worst group | entropy, worst run |")
    print("| --- | --- | --- | --- |")
    best = best_of(stacks, families(), print)
    print(f"\n{best}\n")
    print(*table(stacks, Rules(counted=best)), sep="\n")


if __name__ == "__main__":
    main()
