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

import notebook  # noqa: E402 - see above
import play_runs  # noqa: E402 - see above
from reference import PAGES, decisions_page, title_of  # noqa: E402 - see above

_OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[\w./-]+)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add every decision, and every page without a place, to the navigation."""
    nav: list[dict[str, Any]] = list(config.nav or [])
    decisions = sorted((DOCS / "decisions").glob("*.md"), key=title_of)
    placed = re.findall(r"[\w/-]+\.md", str(nav))
    more = [page.name for page in sorted(DOCS.glob("*.md")) if page.name not in placed]
    explanation = next(section["Explanation"] for section in nav if "Explanation" in section)
    explanation[-1]["Decisions"] += [f"decisions/{page.name}" for page in decisions]
    config.nav = [*nav, {"More": more}] if more else nav
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made from the code."""
    made: dict[str, str | bytes] = {name: make() for name, make in PAGES.items()}
    made["decisions/index.md"] = decisions_page()
    made[notebook.PAGE], pictures = notebook.page()
    for name, content in {**made, **pictures, **_runs()}.items():
        files.append(File.generated(config, name, content=content))
    return files


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

    inside = _OUTSIDE.sub(named, markdown).replace("](decisions)", "](decisions/index.md)")
    return inside.replace("notebook.ipynb)", "notebook.md)")
