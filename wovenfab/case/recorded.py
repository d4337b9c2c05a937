"""The case of a results directory as plain data: it may be damaged, or of another program.

Nothing that it says is executed, and no file that it names is opened.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from wovenfab.record.reading import RUN_AGAIN, UnreadableResultsError, damaged, text_of

#: Longest reason that a message quotes.
_LONGEST_REASON = 200
#: Characters, values and depth of a case; none that was run has more.
LARGEST, MOST_VALUES, DEEPEST = 1_000_000, 100_000, 20


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the keys and values of a YAML file, plain data of a moderate size.

    Raises:
        FileNotFoundError: It is not there.
        UnreadableResultsError: It is no such file.
    """
    text = text_of(path)
    if len(text) > LARGEST:
        raise damaged(path, "the file is too large")
    try:
        content = YAML(typ="safe", pure=True).load(text)
        _require_small(content, [0])
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise UnreadableResultsError(
            f"{path}:{line}: this is not valid YAML: {error.problem}{RUN_AGAIN}"
        ) from None
    except (YAMLError, ValueError, LookupError, TypeError, RecursionError) as error:
        why = " ".join(str(error).split())[:_LONGEST_REASON]
        raise damaged(path, f"this is not valid YAML ({why})") from None
    if not isinstance(content, dict):
        raise damaged(path, "there are no keys with values")
    return content


def _require_small(item: Any, counted: list[int], depth: int = 0) -> None:
    """Require that data are small also where aliases in them are followed.

    Raises:
        ValueError: They are not.
    """
    counted[0] += 1
    if counted[0] > MOST_VALUES or depth > DEEPEST:
        raise ValueError("lists or mappings are nested too deeply")
    if isinstance(item, dict | list):
        for one in item.values() if isinstance(item, dict) else item:
            _require_small(one, counted, depth + 1)
