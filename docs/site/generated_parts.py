"""Parts of pages that are made when the site is built, from the program itself.

A page has ``<!-- generated: NAME -->`` where such a part belongs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import click
import typer
from case_keys import CaseKeys
from sphinx.application import Sphinx

from wovenfab.case import json_schema
from wovenfab.cli.app import app as command_line

_MARK = re.compile(r"<!-- generated: ([\w-]+) -->")


def case_keys() -> str:
    """Return all keys of a case with their values and defaults."""
    return CaseKeys(json_schema()).page()


def commands() -> str:
    """Return the help of each command."""
    group = typer.main.get_command(command_line)
    assert isinstance(group, click.Group)
    return "\n".join(line for name in group.commands for line in _command(name, group))


def _command(name: str, group: click.Group) -> Iterator[str]:
    command = group.commands[name]
    usage = " ".join(command.collect_usage_pieces(click.Context(command)))
    yield f"## wovenfab {name}\n\n{(command.help or '').strip()}\n"
    yield f"```text\nwovenfab {name} {usage}\n```\n"
    yield "| argument or option | meaning |\n|---|---|"
    for parameter in command.params:
        words = getattr(parameter, "help", None) or ""
        if isinstance(parameter, click.Option):
            names = ", ".join(f"`{option}`" for option in parameter.opts)
            if not (parameter.is_flag or parameter.count):
                names += f" `{parameter.make_metavar()}`"
        else:
            names = f"`{parameter.make_metavar()}`"
        yield f"| {names} | {words.strip()} |"
    yield ""


PARTS = {"case-keys": case_keys, "commands": commands}


def insert(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put generated parts into the source of a page."""
    source[0] = _MARK.sub(lambda mark: PARTS[mark[1]](), source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("source-read", insert)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
