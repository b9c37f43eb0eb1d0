"""Makes the FMU of a rig file: source, compiled library and model description in one ZIP file."""

from __future__ import annotations

import hashlib
import pathlib
import shutil
import subprocess
import tempfile
import zipfile
from xml.etree import ElementTree

from hil.fmu.translation import translated
from hil.fmu.variables import OUTPUTS, Variable, variables
from hil.plant import kernel, layout
from rigctl import __version__
from rigctl.config.settings import RigSettings

NAME = "rigctl_plant"
PLATFORM = "x86_64-linux"
_CHANNELS = ("MECHANISM", "FORCE_TANGENTIAL", "MASS")
_ROWS = 16
"""Segments: 7 of the move, one for each force and the mass."""
_FLAGS = ("-std=c11", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
"""Products and sums are rounded apart, as numba's are."""
_HERE = pathlib.Path(__file__).parent
_EPOCH = (1980, 1, 1, 0, 0, 0)


class FmuError(RuntimeError):
    """The FMU cannot be made; ``str()`` is one line."""


def make(settings: RigSettings, file: pathlib.Path) -> None:
    """Write the FMU; the same rig file gives the same source.

    Raises:
        FmuError: there is no C compiler, or the settings have no plant to simulate.
        OSError: the file cannot be written.
    """
    try:
        rows = variables(settings)
    except ValueError as error:
        raise FmuError(str(error)) from None
    source, token = _source(settings, rows)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / f"{NAME}.c").write_text(source)
        library = _compiled(folder)
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for path, data in (
                ("modelDescription.xml", _description(rows, token, settings)),
                (f"binaries/{PLATFORM}/{NAME}.so", library),
                (f"sources/{NAME}.c", source.encode()),
            ):
                archive.writestr(zipfile.ZipInfo(path, _EPOCH), data, zipfile.ZIP_DEFLATED)


def _compiled(folder: pathlib.Path) -> bytes:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise FmuError("fmu: found no C compiler, expected gcc (apt install gcc libc6-dev)")
    command = [compiler, *_FLAGS, f"{NAME}.c", "-o", f"{NAME}.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FmuError(f"fmu: the C compiler failed: {(done.stderr.strip().splitlines() or ['no word'])[0]}")
    return (folder / f"{NAME}.so").read_bytes()


def _source(settings: RigSettings, rows: tuple[Variable, ...]) -> tuple[str, str]:
    """The C file, and its token, which the description has too."""
    simulation = settings.simulation
    assert simulation is not None
    elements = simulation.rope.elements
    starts = ", ".join(repr(float(row.start or 0.0)) for row in rows)
    plant = [row.name.removeprefix("plant.") for row in rows if row.name.startswith("plant.")]
    first_plant = len(rows) - len(plant)
    names = {
        "VARIABLES": len(rows), "FIRST_SETTABLE": len(OUTPUTS), "NODES": max(1, elements), "ELEMENTS": elements,
        "WAITING": 1024, "STEP_NS": simulation.step_us * 1000, "GRAVITY": kernel.GRAVITY,
        **{row.c_name: number for number, row in enumerate(rows) if row.c_name},
        **{name: getattr(layout, name) for name in _CHANNELS},
    }  # fmt: skip
    structs = [
        f"typedef struct {{ double {', '.join(dtype.names or ())}; }} {name};"
        for name, dtype in (("Parameters", layout.PARAMETERS), ("State", layout.STATE), ("View", layout.VIEW))
    ]
    channels = layout.CHANNELS
    body = [
        "/* The plant of a gravity-compensation rig as an FMU, made by python -m hil fmu. Units: mm, N, t, s. */",
        "#include <math.h>",
        "#include <string.h>",
        *structs,
        f"typedef struct {{ double segments[{_ROWS}][5], tones[1][5]; int spans[{channels}][2], "
        f"tone_spans[{channels}][2], cursor[{channels}]; }} Inputs;",
        "typedef struct { double a, b, c; } Several;",
        "static const Several STILL = {0.0, 0.0, 0.0};",
        "static double least(double a, double b);",
        "static double most(double a, double b);",
        *(f"#define {name} {value!r}" for name, value in names.items()),
        "static void set_parameters(Parameters *p, const double *value)",
        "{",
        *(f"    p->{name} = value[{first_plant + place}];" for place, name in enumerate(plant)),
        "}",
        translated(),
        f"static const double START[VARIABLES] = {{{starts}}};",
        (_HERE / "model.c").read_text(),
        (_HERE / "interface.c").read_text(),
    ]
    text = "\n".join(body)
    token = "{" + hashlib.sha256(text.encode()).hexdigest()[:32] + "}"
    return f'#define TOKEN "{token}"\n{text}', token


def _description(rows: tuple[Variable, ...], token: str, settings: RigSettings) -> bytes:
    simulation = settings.simulation
    assert simulation is not None
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=NAME,
        instantiationToken=token,
        description=f"Plant of the rig {settings.rig}: rail, pulley, rope, payload, cylinder",
        generationTool=f"rigctl {__version__}",
        variableNamingConvention="structured",
    )
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=NAME,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        fixedInternalStepSize=repr(simulation.step_us * 1e-6),
    )
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(row.unit for row in rows if row.unit):
        ElementTree.SubElement(units, "Unit", name=unit)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize="0.001")
    listed = ElementTree.SubElement(root, "ModelVariables")
    for number, row in enumerate(rows):
        about = {"name": row.name, "valueReference": str(number), "causality": row.causality,
                 "variability": row.variability, "description": row.meaning}  # fmt: skip
        if row.unit:
            about["unit"] = row.unit
        if row.start is not None:
            about["start"] = str(bool(row.start)).lower() if row.is_boolean else repr(float(row.start))
        elif row.causality == "output":
            about["initial"] = "calculated"
        ElementTree.SubElement(listed, "Boolean" if row.is_boolean else "Float64", about)
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [str(number) for number, row in enumerate(rows) if row.causality == "output"]
    for kind in ("Output", "InitialUnknown"):
        for reference in outputs:
            ElementTree.SubElement(structure, kind, valueReference=reference)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True))
