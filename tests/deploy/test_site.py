import base64
import importlib
import json
import os
import re
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
import reference

import clustermcl
from clustermcl.protocol import answers, health, job_events, steps, work
from clustermcl.protocol.message import Message
from clustermcl.runtime.settings_table import TABLE

pytestmark = pytest.mark.timeout(300)  # the site takes 10 s of a core

REPOSITORY = Path(__file__).parents[2]


def test_the_reference_has_every_setting_command_and_question() -> None:
    settings, commands = reference.settings_page(), reference.commands_page()
    assert {name for name in TABLE if f"| `{name}` |" not in settings} == set()
    assert "## clustermcl check\n" in commands
    assert "Usage: clustermcl check [OPTIONS] {MAP}" in commands


def test_the_reference_has_every_message_with_its_fields() -> None:
    page = reference.messages_page()
    for module in (answers, health, job_events, steps, work):
        for kind in vars(module).values():
            if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message:
                assert f"### {kind.__name__} `{kind.__struct_config__.tag}`" in page
    assert "| `covariance` | `Covariance` |" in page


def test_every_field_that_the_client_hands_out_is_described() -> None:
    bare = [
        (name, field)
        for module in (answers, health, job_events)
        for name, _ in reference.structures(module)
        for field, _, meaning in reference.fields(module, name)
        if not meaning
    ]
    assert bare == []


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="the group docs is not installed; .ci/run makes the site")
    folder = tmp_path_factory.mktemp("site")
    made = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=280, check=False,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return folder


def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    assert (site / "reference/settings/index.html").is_file()
    loaded = re.compile(
        r'<(?:script|img|iframe|source|video)[^>]*(?:src|srcset)="?(?:https?:)?//'
        r'|<link[^>]*rel="?(?:stylesheet|preconnect|preload|icon)[^>]*href="?(?:https?:)?//'
        r"|@import|url\((?:https?:)?//"
    )
    for page in (*site.rglob("*.html"), *site.rglob("*.css")):
        assert loaded.search(page.read_text()) is None, page


def test_the_reference_of_the_library_has_its_public_names_and_methods(site: Path) -> None:
    library = (site / "reference/library/index.html").read_text()
    client = (site / "reference/client/index.html").read_text()
    for name in clustermcl.__all__:
        assert f'id="clustermcl.{name}"' in (client if name == "Client" else library)
    for name in ("pose", "hypotheses", "beliefs", "map", "set_pose"):
        assert f'id="clustermcl.Client.{name}"' in client


def test_the_runs_to_play_are_small_and_hold_all_steps(site: Path) -> None:
    """A browser plays such a page in tests/integration/view/test_drawn.py."""
    for name, count in (("story", 200), ("office", 100), ("kidnapping", 160)):
        page = (site / f"demo/{name}.html").read_text()
        assert len(page) < 1_000_000
        saved = json.loads(re.findall(r'id="saved">(.*?)</script>', page)[0])
        past = json.loads(zlib.decompress(base64.b64decode(saved["past"])))
        assert [step for step, topic, _ in past if topic == "step"] == list(range(count))


def said(cell: Any) -> list[str]:
    """The text that a cell shows; of a picture there is none."""
    data = [output.get("data", {}) for output in cell.get("outputs", ())]
    shown = [each["text/plain"] for each in data if each and "image/png" not in each]
    return [*shown, *(output["text"] for output in cell.get("outputs", ()) if "text" in output)]


def test_the_notebook_runs_and_is_shown_with_its_pictures(site: Path) -> None:
    pytest.importorskip("nbclient", reason="the group docs is not installed; .ci/run runs it")
    notebook = importlib.import_module("notebook")
    executed, kept = notebook.executed(), notebook.kept()
    assert list(map(said, executed.cells)) == list(map(said, kept.cells)), "run docs/notebook.py"
    page = (site / "tutorials/notebook/index.html").read_text()
    assert page.count('src="../notebook-') == 3
