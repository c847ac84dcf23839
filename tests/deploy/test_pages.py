"""The pages of docs: what they name is there, what they print runs, what they list is all."""

import re
import subprocess
import sys
from pathlib import Path

import list_modules
import pytest

from clustermcl.link.access_control import ROLES, rights_of
from clustermcl.protocol.causes import Cause
from clustermcl.runtime.settings_table import TABLE
from tests.unit.evaluation.places import STATUS

REPOSITORY = Path(__file__).parents[2]
OPERATIONS = (REPOSITORY / "docs" / "operations.md").read_text()
SECURITY = (REPOSITORY / "docs" / "security.md").read_text()
PAGES = OPERATIONS + SECURITY
DOCS = sorted((REPOSITORY / "docs").rglob("*.md"))
PAGES_OF_THE_TREE = [*REPOSITORY.glob("*.md"), *DOCS, *REPOSITORY.glob("benchmarks/reports/*.md")]
PYTHON = subprocess.run(
    ["git", "ls-files", "*.py"], cwd=REPOSITORY, capture_output=True, text=True, check=True
).stdout.split()


def test_every_cause_has_a_remedy() -> None:
    table = OPERATIONS.partition("## Dropped or refused data")[2].partition("\n## ")[0]
    table = table.replace("`reading refused: ", "`")
    causes = {f"`{cause.removeprefix('reading refused: ')}`" for cause in Cause}
    assert {cause for cause in causes if cause not in table} == set()


def test_every_metric_is_explained() -> None:
    collector = pytest.importorskip("clustermcl.link.metrics_of_status").StatusCollector
    suffix = {"counter": "_total", "info": "_info"}
    names = {
        made.name + suffix.get(made.type, "") for made in collector(lambda: STATUS, "").collect()
    }
    assert len(names) > 15
    assert {name for name in names if f"`{name}`" not in OPERATIONS} == set()


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


def test_every_python_file_that_a_page_names_is_there() -> None:
    for page in DOCS:
        for name in set(re.findall(r"`([\w/]+\.py)`", page.read_text())):
            assert any(f"/{file}".endswith(f"/{name}") for file in PYTHON), (page, name)


def test_the_list_of_folders_is_that_of_the_files() -> None:
    page = list_modules.PAGE.read_text()
    assert "* `filter/search/`: " in page
    assert page == list_modules.renewed(page), "rewrite it: python docs/list_modules.py"


def without_code(page: Path) -> str:
    return re.sub(r"^ *```.*?^ *```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """The names that a forge gives to the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", without_code(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES_OF_THE_TREE, ids=lambda page: page.stem)
def test_every_link_leads_somewhere_in_the_tree(page: Path) -> None:
    """Not only after the site is built: the forge shows the pages as they are."""
    links = re.findall(r'\]\(([^)\s]+)\)|(?:src(?:set)?|href)="([^"]+)"', without_code(page))
    for link in map("".join, links):
        target, _, anchor = link.partition("#")
        if not re.match(r"https?://|mailto:", link):
            found = page.parent / target if target else page
            assert found.exists(), link
            assert not anchor or found.suffix != ".md" or anchor in anchors(found), link
