"""The modelDescription.xml of an FMU: variables named as the channels, states and parameters, with units."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from xml.etree import ElementTree

from rotorid_torch.core.names import about, unit
from rotorid_torch.model.model import Model

CONTROL, OUTPUT, STATE, START, SLOPE, STEP, HOLD, SETTLE, TIME, THETA = (
    0, 1000, 2000, 3000, 4000, 5000, 5001, 5002, 5003, 10000,
)  # fmt: skip
"""References of the variables, as `runtime/fmu.c` counts them."""


class Fmi(Enum):
    """Version of the interface; 2.0 is what most tools take."""

    TWO = "2.0"
    THREE = "3.0"


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU. start : its value at the beginning; None for one that is calculated."""

    name: str
    reference: int
    causality: str
    variability: str
    unit: str = ""
    about: str = ""
    start: float | bool | None = None


def variables(model: Model, units: Mapping[str, str], step: float, fmi: Fmi) -> list[Variable]:
    """All variables. units : of the controls. step : of the integration, s.

    A control is an input, an output of the model an output, a state that is no output a local variable. Where a flight
    begins are the parameters start.STATE. In FMI 3.0, which has no derivatives of inputs, slope.CONTROL is how fast a
    control changes within a step.
    """
    x, u = model.reference_point
    listed = [
        Variable(n, CONTROL + k, "input", "continuous", units.get(n, _unit(n)), about(n), float(u[k]))
        for k, n in enumerate(model.body.controls)
    ]
    if fmi is Fmi.THREE:
        listed.insert(0, Variable("time", TIME, "independent", "continuous", "s"))
        listed += [
            Variable(
                f"slope.{n}", SLOPE + k, "input", "continuous", f"{units.get(n, _unit(n))}/s", "within a step", 0.0
            )
            for k, n in enumerate(model.body.controls)
        ]
    outputs = model.body.outputs
    listed += [Variable(n, OUTPUT + k, "output", "continuous", _unit(n), about(n)) for k, n in enumerate(outputs)]
    named = {v.name for v in listed}
    states = model.layout.states
    inner = [(k, s) for k, s in enumerate(states) if s.name not in named]
    listed += [Variable(s.name, STATE + k, "local", "continuous", s.unit, s.doc) for k, s in inner]
    listed += [
        Variable(f"start.{s.name}", START + k, "parameter", "tunable", s.unit, "where the flight begins", float(x[k]))
        for k, s in enumerate(states)
    ]
    theta = zip(model.parameter_set.parameters, model.theta.tolist(), strict=True)
    listed += [Variable(p.name, THETA + k, "parameter", "tunable", p.unit, p.doc, v) for k, (p, v) in enumerate(theta)]
    listed.append(Variable("step", STEP, "parameter", "tunable", "s", "longest step of the integration", step))
    settle = "states of effects begin at rest under body states and controls; false: at start.STATE"
    hold = "states stay where the flight begins; only the way of the controls goes on"
    listed.append(Variable("settle", SETTLE, "parameter", "tunable", "", settle, True))
    listed.append(Variable("hold", HOLD, "parameter", "tunable", "", hold, False))
    return listed


def _unit(name: str) -> str:
    return unit(name).replace("²", "2")


def description(listed: list[Variable], fmi: Fmi, identity: Mapping[str, str], step: float) -> bytes:
    """The XML file. identity : name, guid, file (name of the library), tool and description of the model."""
    two = fmi is Fmi.TWO
    root = ElementTree.Element("fmiModelDescription", _head(fmi, identity))
    state = "FMUstate" if two else "FMUState"
    able = ["canHandleVariableCommunicationStepSize", *(["canInterpolateInputs"] if two else [])]
    able += [f"canGetAndSet{state}", f"canSerialize{state}"]
    attributes = {"modelIdentifier": identity["file"], **dict.fromkeys(able, "true")}
    simulation = ElementTree.SubElement(root, "CoSimulation", attributes)
    if two:
        files = ElementTree.SubElement(simulation, "SourceFiles")
        for name in ("fmi2.c", f"{identity['file']}.c"):
            ElementTree.SubElement(files, "File", name=name)
    _units(root, listed)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(step))
    listing = ElementTree.SubElement(root, "ModelVariables")
    for v in listed:
        kind = "Boolean" if isinstance(v.start, bool) else "Real" if two else "Float64"
        value = ({} if v.start is None else {"start": _text(v.start)}) | ({"unit": v.unit} if v.unit else {})
        if two:
            ElementTree.SubElement(ElementTree.SubElement(listing, "ScalarVariable", _common(v)), kind, value)
        else:
            ElementTree.SubElement(listing, kind, _common(v) | value)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for part in ("Output", "InitialUnknown"):
        above = ElementTree.SubElement(structure, f"{part}s") if two else structure
        for place, v in enumerate(listed, 1):
            unknown = {"index": str(place)} if two else {"valueReference": str(v.reference)}
            if v.causality == "output":
                ElementTree.SubElement(above, "Unknown" if two else part, unknown)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _head(fmi: Fmi, identity: Mapping[str, str]) -> dict[str, str]:
    token = "guid" if fmi is Fmi.TWO else "instantiationToken"
    attributes = {"fmiVersion": fmi.value, "modelName": identity["name"], token: identity["guid"]}
    attributes |= {"description": identity["description"], "generationTool": identity["tool"]}
    return attributes | {"variableNamingConvention": "flat"}


def _units(root: ElementTree.Element, listed: list[Variable]) -> None:
    names = sorted({v.unit for v in listed if v.unit})
    if names:
        units = ElementTree.SubElement(root, "UnitDefinitions")
        for name in names:
            ElementTree.SubElement(units, "Unit", name=name)


def _text(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _common(v: Variable) -> dict[str, str]:
    attributes = {"name": v.name, "valueReference": str(v.reference), "causality": v.causality}
    attributes["variability"] = v.variability
    return attributes | ({"description": v.about} if v.about else {})
