"""Make small mistakes in the filter, and see whether the unit tests notice.

    nice .venv/bin/python -m benchmarks.mutations --mutants 200 --jobs 2 --results mutants.json
    nice .venv/bin/python -m benchmarks.mutations --again mutants.json --results mutants.json
    .venv/bin/python -m benchmarks.mutations --report mutants.json

Every mutant is one mistake in one file of a copied tree: a comparison turned or moved by its
border, + for -, * for /, min for max, a number off, `and` for `or`, `not` left out, a statement, a
call or a keyword argument left out, a value not returned. It runs the tests that come near its
module by their imports, the nearest first, until one fails. Those that pass all tests have
survived: either a test is missing or the mistake is none, and then `mutation_reasons.toml` says
why. `--again` tries only survivors of earlier results that have no reason, after new tests were
written; `--report` fails while there are any.

Two hundred take about half an hour of one core. Chance is the seed's (`--seed`), so the same
mutants come back as long as the code is the same.
"""

import argparse
import ast
import copy
import json
import multiprocessing as mp
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
REASONS = Path(__file__).with_name("mutation_reasons.toml")
LEFT_OUT = {"__init__", "arrays", "compiled", "settings"}
"""No decisions in them: types, the compiler's door, defaults that the experiments hold."""
FILTER, KERNELS = "clustermcl/filter", "clustermcl/filter/kernels"
TESTS = tuple(f"tests/unit/{part}" for part in (
    "filter", "coordinator/belief", "coordinator/test_", "changes", "worker/test_",
    "clustermcl/test_replay.py", "evaluation/test_rides.py", "sensor_bridge/test_floor",
    "sensor_bridge/test_pending", "sensor_bridge/test_sources",
))  # fmt: skip
SLOW = ("test_kernels_as_plain_python.py",)
"""It starts processes."""
OF_LIBRARY = "test_warm_up.py"
"""It builds the library of kernels, so it is for the modules that load it only."""
NEAR = 2
"""Imports from a test file to a module."""
ORACLE = ("test_belief_against_grid.py", "test_best_way.py", "test_search_against_grid.py")
OF_BELIEF = ("/test_coordinator.py", "/test_rides.py", *ORACLE)
NEAR_TO_ALL = {FILTER: ORACLE, "clustermcl/jobs": ORACLE, "clustermcl/belief": OF_BELIEF}
"""They run a whole belief, behind more imports."""
LIMIT_CPU_S = 120
KILLER = "killer.txt"

SWAPPED: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,), ast.Pow: (ast.Mult,), ast.And: (ast.Or,), ast.Or: (ast.And,),
}  # fmt: skip
OTHER_NAME = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum",
              "cos": "sin", "sin": "cos", "any": "all", "all": "any"}  # fmt: skip


def variants(node: ast.AST) -> Iterator[ast.AST]:  # noqa: PLR0912 - one branch a mistake
    """The mistakes that can be made at a node."""
    match node:
        case ast.Compare(ops=[op]):
            for other in SWAPPED.get(type(op), ()):
                yield _with(node, ops=[other()])
        case ast.BinOp(op=op) | ast.AugAssign(op=op) | ast.BoolOp(op=op):
            for other in SWAPPED.get(type(op), ()):
                yield _with(node, op=other())
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            yield ast.Constant(value + 1)
        case ast.Call(func=func, args=args, keywords=keywords):
            if isinstance(func, ast.Name | ast.Attribute) and _name(func) in OTHER_NAME:
                key = "id" if isinstance(func, ast.Name) else "attr"
                yield _with(node, func=_with(func, **{key: OTHER_NAME[_name(func)]}))
            elif args and not isinstance(args[0], ast.Starred | ast.GeneratorExp):
                yield args[0]
            for index in range(len(keywords)):
                yield _with(node, keywords=keywords[:index] + keywords[index + 1 :])
    match node:
        case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Continue() | ast.Break():
            yield ast.Pass()
        case ast.Raise() | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield ast.Pass()
        case ast.Return(value=ast.expr()):
            yield ast.Return(ast.Constant(None))
        case ast.IfExp(body=body, orelse=orelse):
            yield from (body, orelse)


def sites(tree: ast.AST) -> Iterator[tuple[str, ast.AST, ast.AST]]:
    """All nodes of running code: the function that they stand in, their parent, themselves."""
    pending: list[tuple[str, ast.AST, ast.AST]] = [("", tree, tree)]
    while pending:
        where, parent, node = pending.pop()
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            where = f"{where}.{node.name}".lstrip(".")
        yield where, parent, node
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "exc", "bases", "pattern"):
                continue  # types and what errors say are no decisions
            inner = value if isinstance(value, list) else [value]
            pending += [(where, node, child) for child in inner if isinstance(child, ast.AST)]


@dataclass(frozen=True)
class Mutant:
    """One mistake."""

    name: str
    """Where it is and what it is; the same as long as that code is the same."""
    path: str
    tree: ast.AST
    node: ast.AST
    variant: ast.AST
    is_compiled: bool
    """Whether machine code depends on it."""

    def source(self) -> str:
        """The whole file with it."""
        tree = _replaced(self.tree, self.node, self.variant)
        return ast.unparse(ast.fix_missing_locations(tree))


def mutants(root: Path) -> list[Mutant]:
    """Every mistake in every module."""
    found = []
    for path in modules(root):
        tree, seen = ast.parse((root / path).read_text()), Counter[str]()
        kernels = [f.name for f in ast.walk(tree) if isinstance(f, ast.FunctionDef)
                   and any(ast.unparse(each) == "kernel" for each in f.decorator_list)]  # fmt: skip
        is_filter = path.startswith(FILTER)
        for where, parent, node in sites(tree):
            for variant in variants(node):
                if ast.unparse(variant) == ast.unparse(node):
                    continue  # `return None`, its value left out
                key = f"{path}:{where}: {_change(parent, node, variant)}"
                seen[key] += 1
                name = key if seen[key] == 1 else f"{key} #{seen[key]}"
                is_compiled = is_filter and (not where or where in kernels)
                found.append(Mutant(name, path, tree, node, variant, is_compiled))
    return found


def modules(root: Path) -> list[str]:
    """The files in which mistakes are made."""
    files = [*root.glob("clustermcl/filter/**/*.py"), *root.glob("clustermcl/belief/*.py")]
    files.append(root / "clustermcl/jobs/jobs.py")
    return sorted(str(f.relative_to(root)) for f in files if f.stem not in LEFT_OUT)


def tests_near(root: Path, path: str) -> list[str]:
    """The test files that reach a module over few imports, the nearest first."""
    reached = {path: 0}
    importers = [path]
    for target in importers:
        if reached[target] < NEAR:
            fresh = [f for f, used in _imports(root).items() if target in used and f not in reached]
            reached |= dict.fromkeys(fresh, reached[target] + 1)
            importers += fresh
    near_to_all = next(part for room, part in NEAR_TO_ALL.items() if path.startswith(room))
    left_out = SLOW if path.startswith(KERNELS) else (*SLOW, OF_LIBRARY)
    chosen = [
        (distance, file)
        for file in _imports(root)
        if Path(file).name.startswith("test_") and not file.endswith(left_out)
        and (((distance := reached.get(file, NEAR + 1)) <= NEAR and file.startswith(TESTS))
             or file.endswith(near_to_all))
    ]  # fmt: skip
    own = f"test_{Path(path).stem}.py"
    return [file for _, file in sorted(chosen, key=lambda c: (not c[1].endswith(own), c))]


@cache
def _imports(root: Path) -> dict[str, set[str]]:
    files = [*root.glob("tests/unit/**/*.py"), *root.glob("clustermcl/filter/**/*.py"),
             *(root / "clustermcl").glob("[bcj]*/**/*.py")]  # fmt: skip
    used = {}
    for file in files:
        found = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
                found |= {name.replace(".", "/") + ".py" for name in names}
        used[str(file.relative_to(root))] = found
    return used


def run(tree: Path, mutant: Mutant | None, tests: list[str]) -> None:
    """In a process of its own: put a mutant in place, run tests, end with pytest's code."""
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, 1)
    os.dup2(devnull, 2)
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_CPU_S, LIMIT_CPU_S))
    import hypothesis  # noqa: PLC0415 - already there: the parent imported it
    import pytest  # noqa: PLC0415

    hypothesis.settings.register_profile(
        "mutants", max_examples=40, deadline=None, database=None,
        suppress_health_check=list(hypothesis.HealthCheck),
    )  # fmt: skip
    sys.dont_write_bytecode = mutant is not None
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    if mutant and not mutant.is_compiled and not mutant.path.startswith(KERNELS):
        from clustermcl.filter.kernels import library  # noqa: PLC0415 - the tree's

        built = library.path()  # although it is of other sources
        library.path = lambda: built
    if mutant:
        (tree / mutant.path).write_text(mutant.source())
    if mutant and mutant.is_compiled:  # a build would take the sources of the installed tree
        from clustermcl.jobs import warm_up  # noqa: PLC0415 - for tests/conftest.py

        warm_up.compile_kernels = lambda _: None  # numba compiles the kernels that are called
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:benchmark", "-p", "no:timeout",
               "-o", "timeout=0", "-W", "ignore::pytest.PytestAssertRewriteWarning",
               "-W", "ignore::pytest.PytestConfigWarning",
               "--hypothesis-profile=mutants"]  # fmt: skip
    os._exit(int(pytest.main([*options, *tests], [_Killer(tree)])))


class _Killer:
    """Notes the test that failed, or the file that could not be imported."""

    def __init__(self, tree: Path) -> None:
        self.note = tree / KILLER  # a test may change the folder

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.note.write_text(report.nodeid.split("[")[0])

    pytest_collectreport = pytest_runtest_logreport


def prepared(folder: Path, paths: set[str]) -> None:
    """Put a copy of the tree there, with its library of kernels; all tests near `paths` pass."""
    tree = folder / "tree"
    for package in ROOT.glob("*/__init__.py"):
        if package.parent.is_symlink():
            continue
        shutil.copytree(package.parent, tree / package.parent.name)
    shutil.copy(ROOT / "pyproject.toml", tree)
    (tree / "docs").mkdir()
    shutil.copy(ROOT / "docs/belief.md", tree / "docs")  # a test reads which settings it names
    tests = sorted({test for path in paths for test in tests_near(tree, path)})
    process = mp.get_context("fork").Process(target=run, args=(tree, None, tests))
    process.start()
    process.join()
    if process.exitcode:
        failed = tree / KILLER
        by = failed.read_text() if failed.exists() else "the start of pytest"
        raise SystemExit(f"without any mistake fails {by}")
    for compiled in (tree / FILTER).rglob("__pycache__"):
        shutil.copytree(compiled, folder / "compiled" / compiled.relative_to(tree))


def tried(chosen: list[Mutant], jobs: int) -> Iterator[tuple[str, str]]:
    """Each mutant's name with `survived` or `killed by ...`, as they end."""
    import hypothesis.strategies  # noqa: F401, PLC0415 - once, for all processes forked from here
    import numba  # noqa: F401, PLC0415
    import pytest  # noqa: F401, PLC0415
    import scipy.ndimage  # noqa: F401, PLC0415

    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        first = Path(name) / "0"
        prepared(first, {mutant.path for mutant in chosen})
        for job in range(1, jobs):
            shutil.copytree(first, Path(name) / str(job))
        free = [(Path(name) / str(job), Path(name) / str(job) / "tree") for job in range(jobs)]
        waiting, running = list(chosen), {}
        while waiting or running:
            while waiting and free:
                folder, tree = free.pop()
                mutant = waiting.pop(0)
                path = tree / mutant.path
                for stale in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
                    stale.unlink()
                args = (tree, mutant, tests_near(tree, mutant.path))
                source = path.read_text()
                process = mp.get_context("fork").Process(target=run, args=args)
                process.start()
                running[process.sentinel] = (process, path, source, mutant, folder, tree)
            for sentinel in wait(list(running)):
                process, path, source, mutant, folder, tree = running.pop(sentinel)
                process.join()
                killer = tree / KILLER
                by = killer.read_text() if killer.exists() else ""
                killer.unlink(missing_ok=True)
                path.write_text(source)  # the root's may have been edited meanwhile
                for compiled in list((tree / FILTER).rglob("__pycache__")):
                    shutil.rmtree(compiled)
                shutil.copytree(folder / "compiled", tree, dirs_exist_ok=True)
                free.append((folder, tree))
                yield mutant.name, _verdict(process.exitcode, by)


def _verdict(exit_code: int | None, by: str) -> str:
    if exit_code in (-signal.SIGXCPU, -signal.SIGKILL):
        return "killed by the time limit"
    if exit_code:
        return f"killed by {by or 'a crash'}"
    return "survived"


def report(results: dict[str, str]) -> str:
    """The survivors and why they live; a survivor without a reason is an error."""
    reasons = _reasons()
    survivors = sorted(name for name, verdict in results.items() if verdict == "survived")
    if unexplained := [name for name in survivors if name not in reasons]:
        raise SystemExit("no reason for:\n" + "\n".join(unexplained))
    files = Counter(v.removeprefix("killed by ").split("::")[0] for v in results.values())
    lines = [f"{len(results)} mutants, {len(results) - len(survivors)} killed.", ""]
    lines += [f"* {count}: {file}" for file, count in files.most_common()]
    lines += ["", "## Survivors, and why", ""]
    lines += [f"* `{name}`\n  {reasons[name]}" for name in survivors]
    return "\n".join(lines)


def _reasons() -> dict[str, str]:
    return tomllib.loads(REASONS.read_text())


def main() -> None:
    parser = argparse.ArgumentParser(description="make mistakes, see whether tests notice")
    parser.add_argument("--mutants", type=int, default=200, help="how many")
    parser.add_argument("--seed", type=int, default=1, help="of the choice")
    parser.add_argument("--jobs", type=int, default=1, help="at a time, each in its own tree")
    parser.add_argument("--seconds", type=float, default=1e9, help="begin none after so long")
    parser.add_argument("--only", default="", help="only mutants whose id holds this")
    parser.add_argument("--again", type=Path, help="only survivors of these results")
    parser.add_argument("--results", type=Path, help="JSON file, read first and added to")
    parser.add_argument("--report", type=Path, help="write the report of these results, run none")
    given = parser.parse_args()
    if given.report:
        print(report(json.loads(given.report.read_text())))
        return
    everything = [mutant for mutant in mutants(ROOT) if given.only in mutant.name]
    count = min(given.mutants, len(everything))
    chosen = random.Random(given.seed).sample(everything, count)
    results: dict[str, str] = {}
    if given.results and given.results.exists():
        results = json.loads(given.results.read_text())
    if given.again:
        again = json.loads(given.again.read_text())
        wanted = {
            name for name, verdict in again.items() if verdict == "survived"
        } - _reasons().keys()
        chosen = [mutant for mutant in everything if mutant.name in wanted]
    else:
        chosen = [mutant for mutant in chosen if mutant.name not in results]
    print(f"{len(chosen)} of {len(everything)} mutants", flush=True)
    started = time.monotonic()
    for name, verdict in tried(chosen, given.jobs):
        print(f"{time.monotonic() - started:6.0f} s {verdict:8} {name}", flush=True)
        results[name] = verdict
        if given.results:
            given.results.write_text(json.dumps(results, indent=1, sort_keys=True))
        if time.monotonic() - started > given.seconds:
            break


def _with(node: ast.AST, **changed: object) -> ast.AST:
    other = copy.copy(node)
    for name, value in changed.items():
        setattr(other, name, value)
    return other


def _replaced(tree: ast.AST, node: ast.AST, variant: ast.AST) -> ast.AST:
    """The tree with another node in one place; the original is not touched."""
    if tree is node:
        return variant
    other = copy.copy(tree)
    for name, value in ast.iter_fields(tree):
        if isinstance(value, list):
            setattr(other, name, [_replaced(i, node, variant) if isinstance(i, ast.AST) else i
                                  for i in value])  # fmt: skip
        elif isinstance(value, ast.AST):
            setattr(other, name, _replaced(value, node, variant))
    return other


def _name(func: ast.Name | ast.Attribute) -> str:
    return func.id if isinstance(func, ast.Name) else func.attr


def _change(parent: ast.AST, node: ast.AST, variant: ast.AST) -> str:
    """A mistake in words."""
    if isinstance(node, ast.Call) and isinstance(variant, ast.Call):
        for keyword in node.keywords:
            if keyword not in variant.keywords:
                return f"{_line(node.func)}(...) without {keyword.arg}"
    change = f"{_line(node)} -> {_line(variant)}"
    if isinstance(node, ast.Constant) and isinstance(parent, ast.expr | ast.Assign | ast.Return):
        change += f" in {_line(parent)}"
    return change


def _line(node: ast.AST) -> str:
    return " ".join(ast.unparse(node).split())[:100]


if __name__ == "__main__":
    main()
