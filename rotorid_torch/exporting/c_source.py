"""A model as C99: header and source, from the traced graph and the runtime beside this file."""

import keyword
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.graph.emit import Constants, straight_line
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.storage.atomic import writing
from rotorid_torch.errors import InputError, Unsupported
from rotorid_torch.exporting.signal_path import Element, control_path, output_path
from rotorid_torch.model.model import Model
from rotorid_torch.validate.free_run import STRAYED

RUNTIME = Path(__file__).parent / "runtime"
DEPTH = 256
"""Samples that a delay looks back to; with shorter steps it keeps only some of them."""
LONGEST_NAME = 40
"""Letters of a title that its name in C keeps."""
MATHEMATICS = """
#define F_sin sin
#define F_cos cos
#define F_sqrt sqrt
#define F_exp exp
#define F_log log
#define F_log1p log1p
#define F_tanh tanh
#define F_asin asin
#define F_acos acos
#define F_atan atan
#define F_atan2 atan2
#define F_pow pow
#define F_abs fabs
#define F_sigmoid(a) (1.0 / (1.0 + exp(-(a))))
#define F_maximum(a, b) ((a) > (b) ? (a) : (b))
#define F_minimum(a, b) ((a) < (b) ? (a) : (b))
"""


@dataclass(frozen=True)
class ModelSource:
    """Header and source of a model; `name` begins every public name in them."""

    name: str
    header: str
    source: str

    def write(self, folder: Path) -> None:
        """NAME.h and NAME.c."""
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{self.name}.h").write_text(self.header)
            (folder / f"{self.name}.c").write_text(self.source)


def identifier(title: str) -> str:
    """A name of C that is as near to a title as can be."""
    name = re.sub(r"[^a-z0-9]+", "_", title.lower()).strip("_")[:LONGEST_NAME] or "model"
    return f"model_{name}" if name[0].isdigit() or keyword.iskeyword(name) else name


def c_source(model: Model, title: str, step: float) -> ModelSource:
    """The model as C; `step` is the longest step of its integration, s.

    Raises InputError: the model holds an operation that has no C, or an effect that looks ahead.
    """
    x, u = model.reference_point
    theta = model.theta.detach()
    try:
        dynamics = Dynamics.of(lambda x, u, th: model.motion(th, x, u), x, u, theta)
    except Unsupported as error:
        raise InputError("export", title, f"cannot be written in C: {error}", "torch operations on numbers") from None
    graph = dynamics.graph
    paths = {"path": control_path(model, graph), "record": output_path(model, graph)}
    constants = Constants(graph, len(theta))
    parts = ("rates", dynamics.rates), ("outputs", dynamics.outputs)
    code = [_function(graph, name, nodes, constants) for name, nodes in parts]
    code += [_element_code(graph, name, elements, constants) for name, elements in paths.items()]
    instants = [e for elements in paths.values() for e in elements if e.kind == "INSTANT"]
    code += [_function(graph, f"instant_{k}", e.results, constants, "u") for k, e in enumerate(instants)]
    prepare = constants.prepare(whole=True)
    numbers = constants.numbers().tolist()
    settled = [k for k, s in enumerate(model.layout.states) if k >= len(model.body.states) and s.channel is None]
    sizes = _sizes(model, paths, prepare, len(numbers), len(settled))
    name = identifier(title)
    tables = [
        _numbers("THETA", [*theta.tolist(), *numbers]),
        _numbers("START", x.tolist()),
        _numbers("TRIM", u.tolist()),
        f"static const double STEP = {step!r}, LIMIT = {STRAYED!r};",
        f"static const int SETTLED[] = {{{_listed([*settled, 0])}}};",
    ]
    body, numbers_of = model.body, model.parameter_set.names
    listed = {"state": model.layout.names, "control": body.controls, "output": body.outputs, "parameter": numbers_of}
    tables += [_names(f"rid_{kind}_names", names) for kind, names in listed.items()]
    pointers = ", ".join([*(f"instant_{k}" for k in range(len(instants))), "0"])
    tables.append(f"static void (*const INSTANTS[])(const double*, const double*, double*) = {{{pointers}}};")
    heading = f'#include "{name}.h"\n\n#include <math.h>\n#include <string.h>\n{MATHEMATICS}'
    kind_names = "enum { DELAY, LAG, RATE_LIMIT, PLAY, INSTANT };"
    runtime = (RUNTIME / "model.c").read_text().replace(f"{kind_names}\n", "")
    source = "\n".join([heading, kind_names, *tables[:-1], prepare, *code, tables[-1], *_kinds(paths), runtime])
    words = re.sub(r"[^\w .,:;()+-]", " ", title)
    header = (RUNTIME / "model.h").read_text().replace("@title@", words).replace("@sizes@", sizes)
    return ModelSource(name, _renamed(header, name), _renamed(source, name))


def _function(graph: Graph, name: str, results: Sequence[int], constants: Constants, inputs: str = "xu") -> str:
    body = straight_line(
        graph, {f"out[{i}]": node for i, node in enumerate(results)}, constants.name, "double", whole=True
    )
    arguments = ", ".join([*(f"const double* {n}" for n in inputs), "const double* c", "double* out"])
    unused = " ".join(f"(void){n};" for n in (*inputs, "c"))
    return f"static void {name}({arguments}) {{\n  {unused}\n{body}\n}}\n"


def _element_code(graph: Graph, name: str, elements: Sequence[Element], constants: Constants) -> str:
    """The function that fills in the sizes of a way's elements."""
    places = {}
    for k, element in enumerate(elements):
        places |= {f"e[{k}].size[{i}]": node for i, node in enumerate(element.sizes)}
        places |= {f"e[{k}].place[{i}]": node for i, node in enumerate(element.places)}
    body = straight_line(
        graph, {f"s[{j}]": n for j, n in enumerate(places.values())}, constants.name, "double", whole=True
    )
    handed = "\n".join(f"  {place} = s[{j}];" for j, place in enumerate(places))
    head = f"  double s[{len(places) + 1}];\n  (void)c; (void)e; (void)s;"
    return f"static void {name}_sizes(const double* c, rid_element* e) {{\n{head}\n{body}\n{handed}\n}}\n"


def _kinds(paths: dict[str, list[Element]]) -> list[str]:
    lines, instants = [], 0
    for name, elements in paths.items():
        places = []
        for element in elements:
            places.append(instants)
            instants += element.kind == "INSTANT"
        kinds = ", ".join([*(e.kind for e in elements), "INSTANT"])
        lines.append(f"static const int {name.upper()}_KINDS[] = {{{kinds}}};")
        lines.append(f"static const int {name.upper()}_INSTANTS[] = {{{_listed([*places, 0])}}};")
    return lines


def _sizes(model: Model, paths: dict[str, list[Element]], prepare: str, numbers: int, settled: int) -> str:
    """Enums of the header: sizes, and places of states, controls and outputs by name."""
    constants = int(re.search(r"NC = (\d+)", prepare)[1])  # pyright: ignore[reportOptionalSubscript]
    nx, nu, ny, count = len(model.layout), len(model.body.controls), len(model.body.outputs), len(model.theta)
    counts = {"NX": nx, "NU": nu, "NY": ny, "NP": count, "THETA": count + numbers, "NC": constants}
    counts |= {"SETTLED": settled, "PATHS": len(paths["path"]), "RECORDS": len(paths["record"])}
    delays = any(e.kind == "DELAY" for elements in paths.values() for e in elements)
    counts |= {"WIDE": max(nu, ny), "DEPTH": DEPTH if delays else 2}
    lines = [f"enum {{ {', '.join(f'RID_{k} = {v}' for k, v in counts.items())} }};"]
    named = {"STATE": model.layout.names, "CONTROL": model.body.controls, "OUTPUT": model.body.outputs}
    for kind, names in named.items():
        places = ", ".join(f"RID_{kind}_{identifier(n).upper()}" for n in names)
        lines.append(f"enum {{ {places} }};")
    return "\n".join(lines)


def _renamed(text: str, name: str) -> str:
    return re.sub(r"\brid_", f"{name}_", re.sub(r"\bRID_", f"{name.upper()}_", text))


def _numbers(name: str, values: Iterable[float]) -> str:
    return f"static const double {name}[] = {{{', '.join(map(_number, values))}}};"


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    return repr(value) if math.isfinite(value) else "HUGE_VAL" if value > 0 else "-HUGE_VAL"


def _names(name: str, words: Sequence[str]) -> str:
    quoted = ", ".join(f'"{w}"' for w in words)
    size = name.replace("rid_state_names", "RID_NX").replace("rid_control_names", "RID_NU")
    size = size.replace("rid_output_names", "RID_NY").replace("rid_parameter_names", "RID_NP + 1")
    return f"const char* const {name}[{size}] = {{{quoted or 0}}};"


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
