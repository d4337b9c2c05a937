"""Shows a run in ParaView: the sheet where it is, coloured by a field, with its yarns.

    paraview --script=open_in_paraview.py                 in the window
    pvpython open_in_paraview.py picture.png [field]      as a picture

Fields: beta, shear_angle, curvature_1, curvature_2, stretch_1, stretch_2; the first that the
run has is taken. wovenfab report writes this file beside fields.xdmf and yarns.xdmf.
"""

import csv
import sys
from pathlib import Path
from typing import Any

from paraview import simple

#: Where the results were when this file was written; they may have moved.
RESULTS = ""
#: Field: label of the colour bar, formula in that unit, whether the sign has a meaning.
FIELDS = {
    "beta": ("slip between the families (mm)", "1000*beta", False),
    "shear_angle": ("shear angle (deg)", "57.29577951308232*shear_angle", False),
    "curvature_1": ("curvature of family 1 (1/m)", "curvature_1", False),
    "curvature_2": ("curvature of family 2 (1/m)", "curvature_2", False),
    "stretch_1": ("strain of family 1 (1e-6)", "1e6*stretch_1", True),
    "stretch_2": ("strain of family 2 (1e-6)", "1e6*stretch_2", True),
}
OTHERWISE = ("displacement (mm)", "1000*mag(moved)", False)
#: Value from 0 to 1 and colour there: pale to strong, or blue to white to red.
PALE = [0, 1, 1, 0.9, 0.35, 1, 0.85, 0.46, 0.7, 0.98, 0.55, 0.15, 1, 0.8, 0.3, 0.01]
SIGNED = [0, 0.02, 0.19, 0.38, 0.5, 0.97, 0.97, 0.97, 1, 0.4, 0, 0.12]
#: The number of a family and the colour of its yarns.
YARNS = [1, 0.1, 0.1, 0.1, 2, 0.12, 0.37, 0.66]
INK = [0.1, 0.1, 0.1]


def show(folder: Path, field: str | None) -> Any:
    """Build the pipeline and return the view."""
    view = simple.GetActiveViewOrCreate("RenderView")
    fields = opened(folder / "fields.xdmf")
    names = list(fields.PointData.keys())
    stored = [name for name in FIELDS if name in names]
    if field is not None and field not in stored:
        sys.exit(f"this run has no field {field}; it has {', '.join(stored)}")
    sheet = draw_sheet(fields, names, field or [*stored, ""][0], view)
    if (folder / "yarns.xdmf").exists():
        draw_yarns(opened(folder / "yarns.xdmf"), view)
    view.ViewTime = time_of_largest_displacement(folder, fields)
    simple.GetTimeKeeper().Time = view.ViewTime
    simple.GetAnimationScene().PlayMode = "Snap To TimeSteps"
    clock = simple.AnnotateTimeFilter(registrationName="time", Input=sheet)
    clock.Format = "{time:.4g} s"
    simple.Show(clock, view).Color = INK
    view_from_above(sheet, view)
    return view


def opened(path: Path) -> Any:
    """Open a series with all of its fields."""
    reader = simple.XDMFReader(registrationName=path.name, FileNames=[str(path)])
    reader.UpdatePipeline()
    return reader


def draw_sheet(fields: Any, names: list[str], colour: str, view: Any) -> Any:
    """Warp the sheet by the mean displacement of its families and colour it."""
    both = "(displacement_1+displacement_2)/2" if "displacement_1" in names else "displacement"
    moved = simple.Calculator(registrationName="displacement", Input=fields)
    moved.Function, moved.ResultArrayName = both, "moved"
    label, formula, signed = FIELDS.get(colour, OTHERWISE)
    scaled = simple.Calculator(registrationName="field", Input=moved)
    scaled.Function, scaled.ResultArrayName = formula, label
    sheet = simple.WarpByVector(registrationName="sheet", Input=scaled)
    sheet.Vectors = ["POINTS", "moved"]
    shown = simple.Show(sheet, view)
    shown.Representation, shown.Ambient, shown.Diffuse = "Surface", 1, 0  # no shading
    simple.ColorBy(shown, ("POINTS", label))
    colours = simple.GetColorTransferFunction(label)
    colours.RGBPoints, colours.ColorSpace = SIGNED if signed else PALE, "RGB"
    shown.RescaleTransferFunctionToDataRangeOverTime()
    if signed:
        low, high = colours.RGBPoints[0], colours.RGBPoints[-4]
        colours.RescaleTransferFunction(-max(-low, high), max(-low, high))
    shown.SetScalarBarVisibility(view, True)
    bar = simple.GetScalarBar(colours, view)
    bar.Title, bar.ComponentTitle, bar.Orientation = label, "", "Horizontal"
    bar.WindowLocation, bar.TitleColor, bar.LabelColor = "Lower Center", INK, INK
    bar.AddRangeLabels = 0
    return sheet


def draw_yarns(yarns: Any, view: Any) -> None:
    """Draw the lines of both families, each in its colour, slightly above the sheet."""
    lifted = simple.Transform(registrationName="yarns", Input=yarns)
    x = yarns.GetDataInformation().GetBounds()
    lifted.Transform.Translate = [0, 0, 1e-3 * (x[1] - x[0])]
    shown = simple.Show(lifted, view)
    simple.ColorBy(shown, ("POINTS", "family"))
    simple.GetColorTransferFunction("family").RGBPoints = YARNS
    shown.SetScalarBarVisibility(view, False)
    shown.LineWidth = 1.5


def time_of_largest_displacement(folder: Path, fields: Any) -> float:
    """Return the stored time (s) at which the program had moved farthest."""
    times = fields.TimestepValues
    times = list(times) if hasattr(times, "__len__") else [times]
    with (folder / "history.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

    def reached(time: float) -> float:
        nearest = min(rows, key=lambda row: abs(float(row["time_s"]) - time))
        return abs(float(nearest["displacement_m"]))

    return float(max(times, key=reached))


def view_from_above(sheet: Any, view: Any) -> None:
    """Show all of the sheet along z, on white."""
    view.UseColorPaletteForBackground = 0
    view.Background = [1, 1, 1]
    view.OrientationAxesVisibility = 0
    view.InteractionMode = "2D"
    simple.Render(view)
    simple.ResetCamera(view)
    left, right, bottom, top, *_ = sheet.GetDataInformation().GetBounds()
    wide, high = view.ViewSize
    view.CameraParallelScale = 0.6 * max(1.3 * (top - bottom), (right - left) * high / wide)
    simple.Render(view)


def results() -> Path:
    """Return the directory of the results: here, or where they were."""
    own = globals().get("__file__")  # unknown inside ParaView's window
    for folder in (Path(own or "").parent, Path.cwd(), Path(RESULTS)):
        if (folder / "fields.xdmf").exists():
            return folder
    sys.exit("there is no fields.xdmf: start this in the directory of the results")


def main(arguments: list[str]) -> None:
    """Show the run; save a picture if one is named."""
    if arguments:
        view = simple.GetActiveViewOrCreate("RenderView")
        view.ViewSize = [1400, 700]
    view = show(results(), arguments[1] if len(arguments) > 1 else None)
    if arguments:
        simple.SaveScreenshot(arguments[0], view)


main([argument for argument in sys.argv[1:] if argument])
