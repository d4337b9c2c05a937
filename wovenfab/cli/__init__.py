"""The command line: ``wovenfab run | check | report | schema``."""

from __future__ import annotations

from wovenfab.cli.app import main

__all__ = ["main"]
