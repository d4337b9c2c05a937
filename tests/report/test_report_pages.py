"""Pages need nothing but themselves, and show what there is of a run."""

import json
import re
from base64 import b64decode
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from mpi4py import MPI

from tests.report.sample import CASE, make
from wovenfab.cli.report import report_results
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.field_file import FieldFile, triangles
from wovenfab.record.fields import read_fields
from wovenfab.record.figures import write_figures
from wovenfab.record.history import ESSENTIAL, read_history
from wovenfab.record.jaws import Jaws
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import Provenance
from wovenfab.record.summary import read_cycles, read_summary, write_cycles, write_summary
from wovenfab.report.page_blocks import PageTable, PageText, cycle_table, section, write_page
from wovenfab.report.pages import (
    default_place,
    flat,
    labels,
    value_texts,
    write_comparison,
    write_run_page,
)
from wovenfab.report.run_data import open_run_data


class Reader(HTMLParser):
    """Collects what a browser would fetch, show and find by name."""

    def __init__(self, page: str) -> None:
        """Read a page."""
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.spoken: list[str] = []
        self.texts: list[str] = []
        self.feed(page)
        self.text = " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag with what it refers to."""
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "srcset", "data", "poster"):
                self.fetched.append(value or "")
            elif name in ("href", "xlink:href"):
                self.links.append(value or "")
            elif name == "id":
                self.ids.append(value or "")
            elif name == "alt":
                self.spoken.append(value or "")

    @property
    def curves(self) -> list[ET.Element]:
        """What the SVG pictures hold."""
        start = "data:image/svg+xml;base64,"
        texts = [b64decode(uri[len(start) :]) for uri in self.fetched if uri.startswith(start)]
        return [ET.fromstring(text) for text in texts]

    @property
    def kinds(self) -> tuple[int, int]:
        """Number of SVG pictures and of PNG pictures."""
        png = sum(uri.startswith("data:image/png;base64,") for uri in self.fetched)
        return len(self.curves), png

    def handle_data(self, data: str) -> None:
        """Note a text."""
        self.texts.append(data)


def cycles_of(results: Path) -> None:
    """Write cycles.csv of a made-up run, as a real one does."""
    history = read_history(results)
    spans = [(cycle.start, cycle.end) for cycle in open_run_data(results).cycles]
    write_cycles(results, history, spans, BiasExtension(Jaws(0.9, 0.3, (0.45, 0.15), (1.0, 0.0))))


@pytest.fixture(scope="module")
def two_cycles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = make(tmp_path_factory.mktemp("pages") / "slip", [0.02, 0.04], every=40)
    cycles_of(results)
    return results


@pytest.fixture(scope="module")
def page(two_cycles: Path) -> str:
    return write_run_page(two_cycles).read_text()


def require_self_contained(page: str) -> Reader:
    reader = Reader(page)
    assert sum(reader.kinds) == len(reader.fetched)
    for svg in reader.curves:
        referred = [v for e in svg.iter() for k, v in e.attrib.items() if k.endswith("href")]
        assert all(link.startswith(("#", "data:")) for link in referred)
        assert not re.search(r"@import|url\((?!#)|<script", ET.tostring(svg, "unicode"))
    assert all(link.startswith("#") for link in reader.links)
    assert {link[1:] for link in reader.links} <= set(reader.ids)
    assert len(set(reader.ids)) == len(reader.ids)
    assert not {"script", "link", "iframe", "object", "embed"} & set(reader.tags)
    assert not re.search(r"@import|url\((?!#)", page)
    return reader


def test_a_page_needs_no_other_file_and_no_network(page: str) -> None:
    reader = require_self_contained(page)
    assert len(reader.spoken) == reader.tags.count("img") == reader.tags.count("figure")
    assert all(reader.spoken)


def test_a_page_shows_every_part_of_a_run(page: str) -> None:
    reader = Reader(page)
    for title in ("Force against", "Cycles", "energies", "Sheet and", "Fields", "Solver", "Case"):
        assert title in reader.text
    # loop, program, energies, losses, solver; mesh, deformed, 2 x family fields, beta, gamma
    assert reader.kinds == (5, 8)
    assert "could not be drawn" not in reader.text
    assert "Finished." in reader.text
    assert CASE.splitlines()[1] in reader.text


def test_its_curves_are_well_formed_and_tell_their_axes(page: str) -> None:
    said = " ".join(text for svg in Reader(page).curves for text in svg.itertext())
    for label in ("displacement (mm)", "force (N)", "velocity (mm/s)", "Newton iterations"):
        assert label in said


@pytest.mark.slow
def test_equal_results_give_equal_pages(two_cycles: Path, page: str) -> None:
    assert write_run_page(two_cycles).read_text() == page


def test_the_table_has_the_numbers_of_the_file(two_cycles: Path) -> None:
    rows = read_cycles(two_cycles)
    table = cycle_table(rows)
    assert [row[0] for row in table.rows] == ["1", "2"]
    at = {title: i for i, title in enumerate(table.head)}
    for row, cells in zip(rows, table.rows, strict=True):
        assert float(cells[at["reversal at (mm)"]]) == pytest.approx(
            1e3 * float(row["peak_displacement_m"]), rel=1e-3
        )
        assert float(cells[at["loss ratio"]]) == pytest.approx(float(row["loss_ratio"]), rel=1e-3)
        degrees = float(cells[at["shear angle, kinematic (°)"]])
        assert degrees == pytest.approx(
            57.29578 * float(row["shear_angle_kinematic_rad"]), rel=1e-3
        )


@pytest.mark.slow
def test_a_run_that_stopped_early_has_its_page(tmp_path: Path) -> None:
    results = make(tmp_path / "stopped", [0.03], placements=1, every=20, stop=50)
    cycles_of(results)
    summary = (results / "summary.json").read_text()
    (results / "summary.json").write_text(summary.replace('"finished"', '"no equilibrium <here>"'))
    reader = require_self_contained(write_run_page(results).read_text())
    assert "Stopped early: no equilibrium <here>." in reader.text
    assert "Figures of each cycle (* not finished)" in reader.text
    assert "could not be drawn" not in reader.text


@pytest.mark.parametrize(
    ("lost", "note", "gone"),
    [
        (["summary.json"], "there is no summary", "Cycles"),
        pytest.param(["fields.h5", "fields.xdmf"], "Finished.", "Fields", marks=pytest.mark.slow),
        pytest.param(["case.yaml"], "Finished.", "title:", marks=pytest.mark.slow),
    ],
)
def test_a_page_does_without_what_a_run_did_not_write(
    lost: list[str], note: str, gone: str, tmp_path: Path
) -> None:
    results = make(tmp_path / "run", [0.03], placements=1, every=80)
    for name in lost:
        (results / name).unlink()
    reader = require_self_contained(write_run_page(results).read_text())
    assert note in reader.text
    assert gone not in reader.text
    assert "could not be drawn" not in reader.text


def test_fields_that_cannot_be_read_are_told(small: Path) -> None:
    (small / "fields.h5").write_bytes(b"no HDF5")
    assert "no fields that can be read" in write_run_page(small).read_text()


@pytest.mark.slow
def test_a_loss_of_stability_is_told_and_shown(small: Path) -> None:
    summary = read_summary(small)
    loss = {"displacement_m": -0.0005, "force_N": -1234.0}
    write_summary(small, summary | {"losses_of_stability": [loss], "saddles": 3}, MPI.COMM_SELF)
    stored = read_fields(small)
    wave = np.column_stack([0 * stored.points()[:, 0], np.sin(np.pi * stored.points()[:, 0] / 0.9)])
    file = FieldFile(
        small,
        "mode",
        triangles(stored.triangles()),
        stored.points(),
        {"displacement": "m", "mode": "1"},
    )
    file.add(0, 0.01, {"displacement": 0 * wave, "mode": wave})
    reader = require_self_contained(write_run_page(small).read_text())
    assert "Stability was lost at -500 µm under -1.23 kN." in reader.text.replace(
        "\N{MINUS SIGN}", "-"
    )
    assert "3 states are saddles" in reader.text
    assert "How it buckles, at a size that shows." in reader.spoken


def test_a_part_that_fails_says_why_and_costs_no_other() -> None:
    def fails() -> list[PageText]:
        raise ValueError("no <ink>\nleft")

    found = section("Ink", lambda: [PageText("before")], fails, lambda: [PageText("after")])
    said = [block.text for block in found.blocks if isinstance(block, PageText)]
    assert said == ["before", "This part could not be drawn: no <ink> left", "after"]


def test_what_users_write_is_text_and_nothing_else(tmp_path: Path) -> None:
    bad = "<script>alert('&')</script>"
    sections = [
        section(bad, lambda: [PageText(bad, verbatim=True), PageTable(bad, [bad], [[bad, bad]])])
    ]
    origin = Provenance(bad, bad)
    page = write_page(tmp_path / "p.html", bad, [bad], [(bad, bad)], sections, origin).read_text()
    assert "<script" not in page
    assert bad in Reader(page).text


def test_several_runs_lie_over_each_other(two_cycles: Path, tmp_path: Path) -> None:
    other = make(tmp_path / "bonded", [0.03], placements=1, every=40, title="Bonded")
    path = write_comparison([two_cycles, other], tmp_path / "both.html")
    reader = require_self_contained(path.read_text())
    assert reader.kinds == (4, 1)  # gamma only is common
    assert "could not be drawn" not in reader.text
    assert "title Bias extension 1:3, made from formulas Bonded" in reader.text
    assert {"slip", "bonded"} <= {text.strip() for text in reader.curves[0].itertext()}


def test_runs_without_cycles_and_fields_are_compared(tmp_path: Path) -> None:
    results = [make(tmp_path / name, [0.03], placements=1, every=80) for name in "ab"]
    for directory in results:
        (directory / "summary.json").unlink()
        (directory / "fields.h5").unlink()
    reader = require_self_contained(write_comparison(results, tmp_path / "p.html").read_text())
    assert reader.kinds == (3, 0)
    assert "a: Not finished" in reader.text


def test_names_of_runs_are_as_short_as_can_be() -> None:
    assert labels([Path("results/a"), Path("results/b")]) == ["a", "b"]
    assert labels([Path("x/a"), Path("y/a"), Path("y/b")]) == ["x/a", "y/a", "y/b"]
    assert labels([Path("a"), Path("a")]) == ["1: a", "2: a"]


def test_the_page_of_several_goes_into_the_folder_that_holds_them(tmp_path: Path) -> None:
    runs = [tmp_path / "sweep" / "a", tmp_path / "sweep" / "more" / "b"]
    assert default_place(runs).resolve() == tmp_path / "sweep" / "comparison.html"


def test_cases_are_compared_key_by_key() -> None:
    case: dict[str, object] = {
        "sheet": {"length": "0.9 m", "fibres": ["45 deg", 0.1]},
        "title": None,
        "output": {"pictures": False},
    }
    assert flat(case) == {
        "sheet.length": "0.9 m",
        "sheet.fibres": "45 deg, 0.1",
        "title": "None",
        "output.pictures": "false",
    }


@pytest.mark.parametrize("many", [False, True])
def test_a_directory_without_results_is_named(
    many: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report_results([tmp_path / "none", *([tmp_path] if many else [])], None) == 2
    assert f"{tmp_path / 'none'} holds no results" in capsys.readouterr().err


def test_an_empty_history_is_told_without_a_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    history = tmp_path / "history.csv"
    for text, reason in (("", "history.csv:1: "), (f"{','.join(ESSENTIAL)}\n", "a single step")):
        history.write_text(text)
        assert report_results([tmp_path], None) == 2
        assert report_results([tmp_path, tmp_path], tmp_path / "p.html") == 2
        said = capsys.readouterr().err
        assert said.count(reason) == len(said.splitlines()) == 2
    assert not (tmp_path / "p.html").exists()


def test_a_title_is_cut_where_it_would_not_be_read(small: Path) -> None:
    case = (small / "case.yaml").read_text()
    (small / "case.yaml").write_text(re.sub(r"title:.*", "title: " + "word " * 50_000, case))
    source = open_run_data(small)
    assert source.title.startswith("word word") and len(source.title) < 1000


def test_more_cycles_than_rows_are_damage(small: Path) -> None:
    summary = json.loads((small / "summary.json").read_text())
    summary["cycles"] = [{"start_s": 1e-6 * i, "end_s": 1e-6 * (i + 1)} for i in range(20_000)]
    (small / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(UnreadableResultsError, match=r"summary\.json: there are 20000 cycles for"):
        open_run_data(small)


@pytest.mark.parametrize("travel", [1e300, 1e-300])
def test_a_summary_out_of_all_range_is_damaged(travel: float, small: Path) -> None:
    summary = json.loads((small / "summary.json").read_text())
    summary["grip_travel_per_program"] = travel
    (small / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(UnreadableResultsError, match="grip_travel_per_program"):
        open_run_data(small)


@pytest.mark.slow
def test_a_page_has_the_figures_of_a_standard_test_in_both_units(tmp_path: Path) -> None:
    results = make(tmp_path / "run", [0.03], every=40)
    test = BiasExtension(Jaws(0.9, 0.3, (0.45, 0.15), (1.0, 0.0)))
    history = read_history(results)
    write_figures(results, [test], history)
    reader = require_self_contained(write_run_page(results).read_text())
    for figure in test.figures(history).values():
        assert figure.definition in reader.texts
        assert {*value_texts(figure)} <= {*reader.texts}
