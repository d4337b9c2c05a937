"""Scenes with thin layers are valid and of all kinds; pages of results name their commit."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.layer_scenes import COUNT, KINDS, SEED, scene
from benchmarks.random_scenes import Row, commits, table
from wovenfab.case import read_case

DOCS = Path(__file__).parents[2] / "docs"
ROW = Row(1, "bending", 1, 1, 1.0, 0.5, 0.002, 0.001, "", commit="0123abc")


def test_scenes_with_layers_are_valid_of_all_kinds_and_the_same_for_the_same_seed(
    tmp_path: Path,
) -> None:
    paths = [scene(number, SEED, tmp_path) for number in range(1, COUNT + 1)]
    texts = [path.read_text() for path in paths]
    assert len(set(texts)) == COUNT
    assert {read_case(path).title for path in paths} == set(KINDS)
    assert scene(3, SEED, tmp_path).read_text() == texts[2]
    assert scene(3, SEED + 1, tmp_path).read_text() != texts[2]


def test_a_table_of_rows_names_the_commits_that_made_them() -> None:
    assert "`0123abc`" in table([ROW])
    assert commits([ROW, replace(ROW, commit="9876def"), replace(ROW, commit="")]).count("`") == 4


@pytest.mark.parametrize("page", ["accuracy", "hard-cases", "random-fabrics"])
def test_a_page_of_results_names_the_commit_that_it_is_of(page: str) -> None:
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    assert re.search(r"^Code of these figures: commit `[0-9a-f]{7,}`", text, re.MULTILINE)
