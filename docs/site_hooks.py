"""Hooks of MkDocs: pages made from the code, links to files, and the navigation."""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))  # MkDocs loads this file alone

from reference import PAGES, decisions_page, title_of  # noqa: E402 - see above

_OUTSIDE = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[\w./-]+)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add every decision, and every page without a place, to the navigation."""
    nav: list[dict[str, Any]] = list(config.nav or [])
    decisions = sorted((DOCS / "decisions").glob("*.md"), key=title_of)
    placed = re.findall(r"[\w/-]+\.md", str(nav))
    more = [page.name for page in sorted(DOCS.glob("*.md")) if page.name not in placed]
    for section in nav:
        if "Decisions" in section:
            section["Decisions"] = [
                "decisions/index.md",
                *(f"decisions/{p.name}" for p in decisions),
            ]
    config.nav = [*nav, {"More": more}] if more else nav
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made from the code."""
    pages = {name: make() for name, make in PAGES.items()}
    pages["decisions/index.md"] = decisions_page()
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


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

    return _OUTSIDE.sub(named, markdown).replace("](decisions)", "](decisions/index.md)")
