"""wovenfab: how woven fabrics stretch, shear, bend, slip and dissipate."""

import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def _version() -> str:
    """Return the version of the source tree this file lies in, or the installed one."""
    project = Path(__file__).parent.parent / "pyproject.toml"
    if project.is_file():
        return str(tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"])
    try:
        return version("wovenfab")
    except PackageNotFoundError:
        return "unknown"


__version__ = _version()
