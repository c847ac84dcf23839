"""The pages of docs: what they name is there, what they print runs, what they list is all."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from clustermcl.link.access_control import ROLES, rights_of
from clustermcl.protocol.answers import Freshness, State
from clustermcl.protocol.causes import Cause
from clustermcl.runtime.settings_table import TABLE
from tests.unit.evaluation.places import STATUS

REPOSITORY = Path(__file__).parents[2]
OPERATIONS = (REPOSITORY / "docs" / "operations.md").read_text()
SECURITY = (REPOSITORY / "docs" / "security.md").read_text()
PAGES = OPERATIONS + SECURITY
README = (REPOSITORY / "README.md").read_text()
DOCS = sorted((REPOSITORY / "docs").rglob("*.md"))
PYTHON = [
    file.relative_to(REPOSITORY)
    for file in REPOSITORY.rglob("*.py")
    if not any(part.startswith(".") for part in file.relative_to(REPOSITORY).parts)
]


@pytest.mark.parametrize("cause", Cause, ids=lambda cause: cause.name)
def test_the_table_of_causes_has_their_sentences(cause: Cause) -> None:
    assert f"| `{cause}` | {cause.means} | " in OPERATIONS


def test_every_metric_is_explained() -> None:
    collector = pytest.importorskip("clustermcl.link.metrics_of_status").StatusCollector
    suffix = {"counter": "_total", "info": "_info"}
    names = {
        made.name + suffix.get(made.type, "") for made in collector(lambda: STATUS, "").collect()
    }
    assert len(names) > 15
    assert {name for name in names if f"`{name}`" not in OPERATIONS} == set()


def test_every_state_is_explained() -> None:
    for state in (*get_args(State), *get_args(Freshness)):
        assert f"`{state}`" in OPERATIONS


def test_the_table_of_roles_is_the_one_in_force() -> None:
    rows = dict(re.findall(r"^\| `(\w+)`[^|]*(\|.*)$", SECURITY, re.MULTILINE))
    assert set(ROLES) <= set(rows)
    wide = {"readings": "`readings/*`", "command": "`command/*`"}
    for role in ROLES:
        rights = rights_of(role)
        viewers = rights_of("viewer") if role == "operator" else None
        for right in ("publishes", "serves", "asks", "reads"):
            for key in getattr(rights, right):
                cell = wide.get(key.split("/")[0], f"`{key.rpartition('/')[2]}`")
                named = cell in rows[role] or f"`{key}`" in rows[role]
                assert named or (viewers and key in getattr(viewers, right)), (role, key)


def test_files_settings_and_commands_named_on_the_pages_exist() -> None:
    for name in set(re.findall(r"\bdeploy/[\w./*-]*[\w*]", PAGES)):
        assert list(REPOSITORY.glob(name)), name
    for name in set(re.findall(r"clustermcl-[a-z-]+(?=[@.`\s])", PAGES)):
        units = {file.stem.rstrip("@") for file in (REPOSITORY / "deploy/systemd").iterdir()}
        assert name in units, name
    sections = {name.split(".")[0] for name in TABLE}
    for setting in set(re.findall(r"`([a-z]+\.[a-z_]+)(?: =[^`]*)?`", PAGES)):
        if setting.split(".")[0] in sections and not setting.endswith((".key", ".pem")):
            assert setting in TABLE, setting
    for command in set(re.findall(r"(?<!-n )\bclustermcl ([a-z][a-z-]+)", PAGES)):
        ran = subprocess.run(
            [sys.executable, "-I", "-m", "clustermcl", command, "--help"],
            capture_output=True, check=False,
        )  # fmt: skip
        assert ran.returncode == 0, command


@pytest.mark.parametrize("page", DOCS, ids=lambda page: page.stem)
def test_every_python_file_that_a_page_names_is_there(page: Path) -> None:
    for name in set(re.findall(r"`([\w/]+\.py)`", page.read_text())):
        assert any(f"/{file.as_posix()}".endswith(f"/{name}") for file in PYTHON), name


def test_the_list_of_modules_is_that_of_the_files() -> None:
    script = REPOSITORY / "docs" / "list_modules.py"
    spec = importlib.util.spec_from_file_location(script.stem, script)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    page = made.PAGE.read_text()
    assert "* `coordinator.py`: " in page
    assert page == made.renewed(page), "rewrite it: python docs/list_modules.py"


def anchors(page: Path) -> set[str]:
    """The names that a forge gives to the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_of_the_readme_leads_somewhere() -> None:
    links = re.findall(r'\]\(([^)]+)\)|src(?:set)?="([^"]+)"', README)
    assert len(links) > 10
    for target, _, anchor in ("".join(link).partition("#") for link in links):
        page = REPOSITORY / target
        assert page.is_file(), target
        assert not anchor or anchor in anchors(page), (target, anchor)


def secrets(role: str) -> list[str]:
    """The command that makes the secret of a role, with the loop's variable filled in."""
    lines = [line.strip() for line in OPERATIONS.splitlines()]
    made = [line for line in lines if "create secret generic certificate-" in line]
    line = made[0] if role == "router" else made[1]
    return line.replace("$role", role).split()


@pytest.mark.parametrize("role", ["router", "bridge", "coordinator", "worker"])
def test_the_secrets_of_kubernetes_are_made_as_printed(role: str, tmp_path: Path) -> None:
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed")
    (tmp_path / "certificates").mkdir()
    for name in ("authority.pem", f"{role}.pem", f"{role}.key"):
        (tmp_path / "certificates" / name).write_text("x")
    command = [*secrets(role), "--dry-run=client", "--output=json"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    own = "router" if role == "router" else "own"
    for name in ("authority.pem", f"{own}.pem", f"{own}.key"):
        assert f'"{name}": "eA=="' in ran.stdout
