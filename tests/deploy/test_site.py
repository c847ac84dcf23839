"""The site of docs/: what is made from the code is complete, and no link leads nowhere."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from clustermcl.client import Client
from process_runtime.settings_table import TABLE
from protocol import answers, health, job_events, steps, work
from protocol.message import Message

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("reference", REPOSITORY / "docs/reference.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def test_the_reference_has_every_setting_command_and_question(reference: ModuleType) -> None:
    settings, commands = reference.settings_page(), reference.commands_page()
    assert {name for name in TABLE if f"| `{name}` |" not in settings} == set()
    assert "## clustermcl check\n" in commands
    assert "Usage: clustermcl check [OPTIONS] {MAP}" in commands
    client = reference.client_page()
    for name in ("pose", "hypotheses", "beliefs", "map", "set_pose"):
        assert hasattr(Client, name)
        assert f"\n## {name}\n" in client


def test_the_reference_has_every_message_with_its_fields(reference: ModuleType) -> None:
    page = reference.messages_page()
    for module in (answers, health, job_events, steps, work):
        for kind in vars(module).values():
            if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message:
                assert f"### {kind.__name__} `{kind.__struct_config__.tag}`" in page
    assert "| `covariance` | `Covariance` |" in page


@pytest.mark.parametrize("module", [answers, health, job_events], ids=lambda m: m.__name__)
def test_every_field_that_the_client_hands_out_is_described(
    module: ModuleType, reference: ModuleType
) -> None:
    bare = [
        (name, field)
        for name, _ in reference.structures(module)
        for field, _, told in reference.fields(module, name)
        if not told
    ]
    assert bare == []


def test_the_site_is_made_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the extra docs is not installed; .ci/run makes the site")
    made = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    assert (tmp_path / "site/reference/settings/index.html").is_file()
    html = "".join(page.read_text() for page in (tmp_path / "site").rglob("*.html"))
    assert 'src="http' not in html, "something is loaded from elsewhere"
