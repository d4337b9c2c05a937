"""The command line: ``wovenfab run | check | report | schema``."""

from __future__ import annotations

from wovenfab.commands.app import main

__all__ = ["main"]
