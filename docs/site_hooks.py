"""Hooks of MkDocs: pages made from the code, runs that play, links to files, the navigation."""

import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]  # MkDocs loads this file alone

import list_modules  # noqa: E402 - see above
import notebook  # noqa: E402 - see above
import play_runs  # noqa: E402 - see above
from reference import PAGES  # noqa: E402 - see above

_OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[\w./-]+)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add every page without a place to the navigation."""
    nav: list[dict[str, Any]] = list(config.nav or [])
    placed = re.findall(r"[\w/-]+\.md", str(nav))
    pages = [page.relative_to(DOCS).as_posix() for page in sorted(DOCS.rglob("*.md"))]
    more = [page for page in pages if page not in placed]
    config.nav = [*nav, {"More": more}] if more else nav
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made from the code."""
    made: dict[str, str | bytes] = {name: make() for name, make in PAGES.items()}
    made["index.md"] = _home()
    made["reference/modules.md"] = list_modules.modules_page()
    made[notebook.PAGE], pictures = notebook.page()
    for name, content in {**made, **pictures, **_runs()}.items():
        files.append(File.generated(config, name, content=content))
    return files


def _home() -> str:
    """The README, with its links as from this folder, and runs to play."""
    readme = (DOCS.parent / "README.md").read_text()
    readme = re.sub(r"\]\((?!https?:|docs/|#)", "](../", readme)
    readme = re.sub(r"""(\]\(|src(?:set)?=")docs/""", r"\1", readme)
    played = ", ".join(f"[{name}](demo/{name}.html#step=0)" for name in play_runs.STORIES)
    return readme.replace(
        "## Try it\n", f"**Play a run** without installing (press ▶): {played}.\n\n## Try it\n"
    )


@cache
def _runs() -> dict[str, str]:
    """The runs take some seconds; `mkdocs serve` makes them once."""
    return {f"demo/{name}.html": play_runs.page(story) for name, story in play_runs.STORIES.items()}


def on_post_page(output: str, **_rest: object) -> str:
    """Name the search for screen readers, which the theme leaves out."""
    search = 'data-md-component="search" role="dialog"'
    return output.replace(search, f'{search} aria-label="Search"')


def on_page_markdown(markdown: str, page: Page, **_rest: object) -> str:
    """Replace links to files outside the site by their names; the files must exist."""
    here = DOCS / page.file.src_uri

    def named(link: re.Match[str]) -> str:
        words, target = link[1], (here.parent / link[2]).resolve()
        if target.is_relative_to(DOCS):
            return link[0]
        if not target.exists():
            raise PluginError(f"{page.file.src_uri} links to {link[2]}, which is not there")
        return f"{words} (`{target.relative_to(DOCS.parent)}` in the repository)"

    return _OUTSIDE.sub(named, markdown).replace("notebook.ipynb)", "notebook.md)")
