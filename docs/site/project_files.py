"""Files of the project to which pages link become pages of the site, with their source coloured.

So ``[a case](../configs/shear.yaml)`` leads to a readable page from disk, too; of a folder to the
list of its files.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments.util import ClassNotFound
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.highlighting import PygmentsBridge
from sphinx.transforms import SphinxTransform

DOCS = Path(__file__).resolve().parents[1]
PROJECT = DOCS.parent
LANGUAGES = {".geo": "c", ".csv": "text", ".ipynb": "json", "": "text"}
#: What a folder shows of its files.
SHOWN = {".py", ".yaml", ".csv", ".geo", ".md"}
#: Files and folders that pages link to, relative to the project; a build reads all pages.
linked: set[Path] = set()


class LinkToFilePages(SphinxTransform):
    """Turns links to files of the project that are no pages into links to their pages."""

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        """Replace the links of one page."""
        for link in [*self.document.findall(_is_link)]:
            name = link["reftarget"].partition("#")[0]
            if link.get("refdomain") == "doc":  # a text in Markdown, whose suffix is left out
                name += ".md"
            target = ((DOCS / self.env.docname).parent / name).resolve()
            if not target.exists() or not target.is_relative_to(PROJECT):
                continue
            linked.add(target.relative_to(PROJECT))
            page = f"{place(target.relative_to(PROJECT))}.html"
            uri = posixpath.relpath(page, posixpath.dirname(self.env.docname) or ".")
            link.replace_self(nodes.reference("", "", *link.children, internal=True, refuri=uri))


def _is_link(node: nodes.Node) -> bool:
    if isinstance(node, addnodes.pending_xref):  # a folder, or a text outside of docs/
        return node.get("reftype") == "myst" and node["reftarget"].startswith(("../", "/"))
    return isinstance(node, addnodes.download_reference)


def place(path: Path) -> str:
    """Return the name of the page of a file or folder."""
    return f"files/{path.as_posix()}" + ("/index" if (PROJECT / path).is_dir() else "")


def pages(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Yield a page for each file and folder that is linked, and for all in these folders."""
    bridge = PygmentsBridge("html", app.config.pygments_style or "default")
    waiting, done = sorted(linked), set()
    while waiting:
        path = waiting.pop()
        if path in done:
            continue
        done.add(path)
        if (PROJECT / path).is_dir():
            inside = [p.relative_to(PROJECT) for p in sorted((PROJECT / path).iterdir())
                      if p.suffix in SHOWN or (p.is_dir() and p.name != "__pycache__")]  # fmt: skip
            waiting += inside
            here = posixpath.dirname(place(path))
            rows = (
                f'<li><a href="{posixpath.relpath(place(p), here)}.html">{escape(p.name)}</a></li>'
                for p in inside
            )
            body = f"<ul>{''.join(rows)}</ul>"
        else:
            text = (PROJECT / path).read_text(encoding="utf-8")
            body = _coloured(bridge, text, path.suffix)
        title = escape(path.as_posix())
        yield place(path), {"title": title, "body": f"<h1>{title}</h1>{body}"}, "page.html"


def _coloured(bridge: PygmentsBridge, text: str, suffix: str) -> str:
    language = LANGUAGES.get(suffix, suffix[1:])
    try:
        return str(bridge.highlight_block(text, language, force=True))
    except ClassNotFound:
        return f"<pre>{escape(text)}</pre>"


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    linked.clear()
    app.add_transform(LinkToFilePages)
    app.connect("html-collect-pages", pages)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
