"""The ``wovenfab`` command: its subcommands with their arguments and options."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from wovenfab.case import CaseError
from wovenfab.cli.console import (
    BAD_INPUT,
    INTERRUPTED,
    Console,
    is_launched,
    prepare_streams,
)
from wovenfab.lacking import LackingError, module_is_missing
from wovenfab.mpi import abort
from wovenfab.plain_text import printable
from wovenfab.simulation.progress import signal_behind

_option = partial(typer.Option, show_default=False)
_directory = partial(_option, "-o", "--output")
_argument = partial(typer.Argument, show_default=False)

CaseFile = Annotated[Path, _argument(help="The case file (YAML).")]
Overrides = Annotated[
    list[str] | None,
    _option(
        "--set",
        metavar="KEY=VALUE",
        help='Change a value of the case, as in --set effects.shear.stiffness="500 N/m".',
    ),
]
Fabric = Annotated[
    Path | None,
    _option(
        "--fabric",
        metavar="FILE",
        help="A fabric (YAML) for a case file that is a test, as in --fabric "
        "configs/fabrics/glass-plain.yaml.",
    ),
]
Jobs = Annotated[
    int | None, _option("--jobs", "-j", min=1, help="Runs side by side; one a processor.")
]
OnCluster = Annotated[
    str,
    typer.Option(
        "--cluster",
        metavar="local|slurm|ADDRESS",
        help="Where runs are made: here, by jobs of Slurm, or by a Dask scheduler (tcp://HOST:PORT).",
    ),
]
Ranks = Annotated[int, typer.Option("--ranks", min=1, help="MPI ranks of each run.")]
Output = Annotated[
    Path | None,
    _directory(
        help="Directory of all that is written; a folder of results/ named after the case "
        "unless given."
    ),
]
Until = Annotated[
    str | None,
    _option(
        "--until",
        metavar="TIME",
        help='Pause at this time of the program, as in --until "12 s"; resume goes on.',
    ),
]
Verbose = Annotated[
    int,
    _option(
        "-v",
        "--verbose",
        count=True,
        metavar="",  # it takes no value, though typer would say INTEGER
        help="Say why steps are cut and methods change (-v), and each iteration (-vv).",
    ),
]
Log = Annotated[Path | None, _option("--log", help="Write all of that, with times, to a file.")]
Petsc = Annotated[
    list[str] | None,
    _argument(help="PETSc options after a double dash, as in -- -snes_monitor."),
]
Page = Annotated[
    Path | None,
    _directory(help="Page of several runs; comparison.html in the folder that holds them all."),
]


Columns = Annotated[
    list[str] | None,
    _option(
        "--columns",
        metavar="NAME=COLUMN",
        help="Column of a quantity by name or number (from 1), as in --columns force=Kraft.",
    ),
]
Units = Annotated[
    list[str] | None,
    _option(
        "--units",
        metavar="NAME=UNIT",
        help='Unit of a quantity, as in --units force=kN; "force=-1 N" reverses the sign.',
    ),
]
Rows = Annotated[
    str | None,
    _option(
        "--rows",
        metavar="FIRST-LAST",
        help="Lines of the file with the numbers, as in --rows 12-340.",
    ),
]
Decimal = Annotated[
    str | None,
    _option("--decimal", metavar="point|comma", help="The decimal sign, if numbers do not tell."),
]
Sheet = Annotated[
    str | None,
    _option("--sheet", metavar="NAME", help="The sheet of a workbook; that with the most rows."),
]


app = typer.Typer(
    help="Predict how woven fabrics stretch, shear, bend, slip and lose energy to friction.\n\n"
    "A case is a YAML file; try [bold]wovenfab check configs/bias-1x3.yaml[/bold], then "
    "[bold]wovenfab run configs/bias-1x3.yaml[/bold]. On several processors: "
    "[bold]mpirun -n 2 wovenfab run …[/bold]. Results open in ParaView (fields.xdmf).",
    rich_markup_mode="rich",
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from wovenfab.versions import installed

        found = installed()
        petsc = found["petsc"]  # that of petsc4py, whose last number may be another one
        typer.echo(f"wovenfab {found['wovenfab']}\ndolfinx {found['dolfinx']}")
        typer.echo(f"PETSc {petsc.rpartition('.')[0]} (petsc4py {petsc})\nMPI: {found['mpi']}")
        typer.echo(f"Python {found['python']}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the versions."),
    ] = False,
) -> None:
    """Take the options that stand before a subcommand."""


@app.command()
def run(
    case: CaseFile,
    fabric: Fabric = None,
    output: Output = None,
    overrides: Overrides = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the results of an earlier run there.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where an earlier run of the case has stopped.")
    ] = False,
    until: Until = None,
    ranks: Ranks = 1,
    verbose: Verbose = 0,
    log: Log = None,
    petsc: Petsc = None,
) -> None:
    """Run a case: history.csv, fields.xdmf, summary.json and pictures in a directory.

    Exit code 0: finished; 2: the case or the directory cannot be used; 3: a step could not be
    made or the sheet buckled; 4: results could not be written; 130 or 143: interrupted. All
    results before that are in the directory.
    """
    from wovenfab.cli.run import launch, run_case

    if ranks > 1 and not is_launched():
        sys.exit(launch(ranks, sys.argv[1:]))
    code = run_case(
        case,
        output,
        overrides or [],
        fabric=fabric,
        overwrite=overwrite,
        resume=resume,
        until=until,
        petsc=petsc or (),
        verbosity=verbose,
        log_file=log,
    )
    sys.exit(code)


@app.command()
def resume(
    directory: Annotated[Path, _argument(help="The results directory of the run.")],
    overrides: Overrides = None,
    until: Until = None,
    ranks: Ranks = 1,
    verbose: Verbose = 0,
    log: Log = None,
    petsc: Petsc = None,
) -> None:
    """Go on with a run that was stopped, from its newest checkpoint; on any number of ranks.

    A finished run goes on with a longer program: --set "program.amplitudes=[20 mm, 40 mm]".
    Exit codes as of run.
    """
    case = directory / "case.yaml"
    run(case, None, directory, overrides, False, True, until, ranks, verbose, log, petsc)


@app.command()
def check(
    case: CaseFile,
    fabric: Fabric = None,
    overrides: Overrides = None,
    resolved: Annotated[
        bool,
        typer.Option(
            "--resolved",
            help="Print the whole case instead, with all it takes over and every default.",
        ),
    ] = False,
) -> None:
    """Validate a case and say what would be built: effects, unknowns, steps, memory."""
    from wovenfab.cli.check import check_case

    sys.exit(check_case(case, overrides or [], resolved, fabric))


@app.command()
def sensitivities(
    case: CaseFile,
    fabric: Fabric = None,
    output: Output = None,
    overrides: Overrides = None,
    by: Annotated[
        list[str] | None,
        _option(
            "--by",
            metavar="PARAMETER",
            help="A parameter, as in --by shear.stiffness; all of the case unless given.",
        ),
    ] = None,
    fit: Annotated[
        Path | None,
        _option(
            "--fit",
            metavar="FILE",
            help="Predict with the parameters of a fit (its fit.json), with a band of 95 %.",
        ),
    ] = None,
    lab: Annotated[
        Path | None,
        _option("--lab", metavar="FILE", help="A measured curve beside the band of --fit."),
    ] = None,
    columns: Columns = None,
    units: Units = None,
    rows: Rows = None,
    decimal: Decimal = None,
    sheet: Sheet = None,
) -> None:
    """Differentiate force and dissipated energy by each parameter, along the whole program.

    Table and picture go into results/<name of the case>-sensitivities. The last five options say
    how the file of --lab is read.
    """
    from wovenfab.cli.studies import differentiate
    from wovenfab.measured.layout import layout_of_options
    from wovenfab.measured.names import SI

    layout = layout_of_options(columns or [], units or [], rows, decimal, sheet, SI)
    sys.exit(differentiate(case, output, overrides or [], by or [], fabric, fit, lab, layout))


@app.command()
def fit(
    files: Annotated[list[Path], _argument(help="Fit files (YAML), one or more.")],
    output: Output = None,
    leave_out: Annotated[
        bool,
        typer.Option(
            "--leave-out", help="Predict each test by a fit to all others, and compare files by it."
        ),
    ] = False,
    jobs: Jobs = None,
    ranks: Ranks = 1,
    cluster: OnCluster = "local",
) -> None:
    """Find material parameters from measured curves: values, intervals, a page, the fitted case.

    A fit file names tests (a case and a measured file each) and the parameters to find; try
    configs/lab/glass-plain-fit.yaml. Several files, such as with and without an effect, are
    compared by their misfit and by the Bayesian information criterion, and with --leave-out by
    how well they predict tests that they were not given.
    """
    from wovenfab.cli.studies import fit_all
    from wovenfab.study.cluster import Cluster

    sys.exit(fit_all(files, output, Cluster(cluster, jobs, ranks), leave_out))


@app.command()
def effects(
    case: CaseFile,
    fabric: Fabric = None,
    output: Output = None,
    overrides: Overrides = None,
) -> None:
    """Measure what each effect costs and changes: the case whole, without each, each alone.

    Table and chart go into results/<name of the case>-effects.
    """
    from wovenfab.cli.studies import study_effects

    sys.exit(study_effects(case, output, overrides or [], fabric))


@app.command()
def accuracy(
    case: CaseFile,
    fabric: Fabric = None,
    output: Output = None,
    overrides: Overrides = None,
    levels: Annotated[
        int,
        typer.Option(
            "--levels",
            min=1,
            max=5,
            help="How often cells and steps are halved, and how many of 5, 1, 0.3, 0.1 and 0.03 % "
            "are asked for.",
        ),
    ] = 2,
) -> None:
    """Show what accuracy costs in time, and whether the errors are true that runs state.

    Degrees 2 to 4 on ever finer cells with ever more steps, and some target accuracies, are run
    and compared with a finer answer. Each run is kept: repeat the command to go on after an
    interruption, or with more levels to know more.
    """
    from wovenfab.cli.studies import study_accuracy

    sys.exit(study_accuracy(case, output, overrides or [], levels, fabric))


@app.command()
def sweep(
    cases: Annotated[list[Path], _argument(help="Case files, or a sweep file (YAML).")],
    fabrics: Annotated[
        list[Path] | None,
        _option(
            "--fabric",
            metavar="FILE",
            help="A fabric (YAML) for case files that are tests; several are compared.",
        ),
    ] = None,
    over: Annotated[
        list[str] | None,
        _option(
            "--over",
            metavar="KEY=VALUE,VALUE",
            help='Values of a key, as in --over "sheet.length=0.6 m,0.9 m"; all combinations are '
            "run.",
        ),
    ] = None,
    overrides: Overrides = None,
    output: Output = None,
    jobs: Jobs = None,
    ranks: Ranks = 1,
    cluster: OnCluster = "local",
) -> None:
    """Run a case with other values side by side: a table and a picture of all loops.

    Repeat the command to go on after an interruption; only what changed is computed again.
    Exit code 0: all finished; 2: a case cannot be used, nothing is run; 3: a run failed.
    """
    from wovenfab.cli.studies import run_sweep
    from wovenfab.study.cluster import Cluster

    where = Cluster(cluster, jobs, ranks)
    sys.exit(run_sweep(cases, over or [], overrides or [], output, where, fabrics or []))


@app.command()
def report(
    directories: Annotated[list[Path], _argument(help="Results directories, one or more.")],
    output: Page = None,
    animation: Annotated[
        bool, typer.Option("--animation", help="One cycle in motion, too: animation.gif.")
    ] = False,
    lab: Annotated[
        Path | None,
        _option(
            "--lab",
            metavar="FILE",
            help="A measured curve: draw the runs over it (lab.png) and say how far they are.",
        ),
    ] = None,
    columns: Columns = None,
    units: Units = None,
    rows: Rows = None,
    decimal: Decimal = None,
    sheet: Sheet = None,
) -> None:
    """Report a run from its files alone, or compare several: pages, pictures, yarns.

    The last five options say how the file of --lab is read; wovenfab measured FILE shows it.
    """
    from wovenfab.cli.report import report_results
    from wovenfab.measured.layout import layout_of_options
    from wovenfab.measured.names import SI

    layout = layout_of_options(columns or [], units or [], rows, decimal, sheet, SI)
    sys.exit(report_results(directories, output, animation, lab, layout))


@app.command()
def measured(
    file: Annotated[Path, _argument(help="The measured file: CSV or other text, or XLSX.")],
    columns: Columns = None,
    units: Units = None,
    rows: Rows = None,
    decimal: Decimal = None,
    sheet: Sheet = None,
) -> None:
    """Show how a measured curve is read: columns, units, rows, branches, largest force."""
    from wovenfab.cli.report import show_measured
    from wovenfab.measured.layout import layout_of_options
    from wovenfab.measured.names import SI

    layout = layout_of_options(columns or [], units or [], rows, decimal, sheet, SI)
    sys.exit(show_measured(file, layout))


@app.command()
def export(
    directory: Annotated[Path, typer.Argument(help="The results directory.", show_default=False)],
    output: Annotated[
        Path | None, _directory(help="Where the files go; export in the results directory.")
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            "--at",
            "--times",
            show_default=False,
            help="Times or displacements, as in --at 0.5,1 or --at '20 mm, 40 mm'.",
        ),
    ] = None,
    every: Annotated[
        int | None, typer.Option("--every", min=1, help="Every so many stored times.")
    ] = None,
    last: Annotated[bool, typer.Option("--last", help="The last stored time.")] = False,
    compare: Annotated[
        Path | None,
        typer.Option(
            "--compare",
            metavar="FILE",
            help="Measured displacements of points (x, y, ux, uy): map of the distances.",
        ),
    ] = None,
    align: Annotated[
        bool,
        typer.Option("--align", help="Find how the camera's coordinates are turned and moved."),
    ] = False,
    positions: Annotated[
        str,
        typer.Option(
            "--positions",
            metavar="auto|rest|moved",
            help="Whether x and y are positions at rest or moved ones.",
        ),
    ] = "auto",
    columns: Columns = None,
    units: Units = None,
    rows: Rows = None,
    decimal: Decimal = None,
    sheet: Sheet = None,
) -> None:
    """Write stored fields as VTU and CSV, or compare them with a camera's cloud of points.

    The last five options say how the file of --compare is read, as in --units x=mm,y=mm.
    """
    from wovenfab.cli.report import export_results
    from wovenfab.measured.cloud import CLOUD
    from wovenfab.measured.layout import layout_of_options

    layout = layout_of_options(columns or [], units or [], rows, decimal, sheet, CLOUD)
    sys.exit(export_results(directory, output, at, every, last, compare, layout, align, positions))


@app.command()
def schema(
    effects: Annotated[
        bool, typer.Option("--effects", help="Print a page on the effects instead, in Markdown.")
    ] = False,
) -> None:
    """Print the JSON Schema of case files, for editors that complete and check YAML."""
    import json

    from wovenfab.case import json_schema
    from wovenfab.cli.check import effects_page, published_schema

    if effects:
        typer.echo(effects_page(), nl=False)
        return
    typer.echo(json.dumps(published_schema(json_schema()), indent=2))


def guarded(command: Callable[[], None]) -> None:
    """Run a command line; no traceback for anything that a user did."""
    prepare_streams()
    console = Console()
    try:
        " ".join(sys.argv).encode()
    except UnicodeEncodeError:
        console.problem("an argument is not UTF-8 text; give the file another name")
        sys.exit(BAD_INPUT)
    if odd := next((a for a in sys.argv if printable(a) != a), None):  # typer would print it
        console.problem(f"an argument has control characters: {odd}; give the file another name")
        sys.exit(BAD_INPUT)
    try:
        command()
    except CaseError as error:
        console.problem(str(error))
        sys.exit(BAD_INPUT)
    except LackingError as error:
        console.problem(str(error))
        sys.exit(BAD_INPUT)
    except ModuleNotFoundError as error:
        console.problem(module_is_missing(error))
        sys.exit(BAD_INPUT)
    except Exception as error:
        if signal_behind(error):
            console.problem("interrupted")
            sys.exit(INTERRUPTED)
        # A fault of the program: say so, and take the other ranks down with this one.
        print(printable(traceback.format_exc()), end="", file=sys.stderr)
        print("wovenfab: this is a fault of the program; please report it.", file=sys.stderr)
        abort()
        sys.exit(1)


def main() -> None:
    """Run ``wovenfab``; without a word it prints its help."""
    # Click's own no_args_is_help takes "[x", a word that begins with a sign, for no word at all.
    guarded(lambda: app(sys.argv[1:] or ["--help"], prog_name="wovenfab"))
