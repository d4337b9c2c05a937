"""A case built in Python, from the classes that validate YAML.

``env/enter python3 examples/case_in_python.py``
"""

import wovenfab

case = wovenfab.Case(
    title="Bias extension of a soft fabric",
    sheet={"length": "0.30 m", "width": "0.10 m", "fibres": ["45 deg", "-45 deg"]},
    effects={
        "stretch": {"stiffness": "5e5 N/m"},
        "shear": {"stiffness": "40 N/m"},
        "bending": {"stiffness": "0.02 N*m"},
    },
    boundary={"left": "clamp", "right": {"displacement": ["program", 0]}},
    program={"type": "ramp", "to": "10 mm", "steps": 5},
    discretisation={"degree": 3, "mesh_size": "50 mm"},
)
for stiffness in ("40 N/m", "80 N/m"):
    run = wovenfab.simulate(case.changed(f"effects.shear.stiffness={stiffness}"))
    print(f"shear stiffness {stiffness}: {run.history['force'][-1]:.4g} N at 10 mm")

try:
    wovenfab.Case(sheet={"length": "0.3 m"}, effects={}, boundary={}, program={})
except wovenfab.CaseError as error:
    print(f"errors of a case are reported as for a file:\n{error}")
