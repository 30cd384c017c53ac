"""A model as an FMU for co-simulation: description, sources and a library, in one archive; no Python inside."""

import hashlib
import json
import platform
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rotorid_torch.core.storage.atomic import scratch_folder
from rotorid_torch.exporting.c_source import RUNTIME, ModelSource, c_source
from rotorid_torch.exporting.compiler import library, suffix
from rotorid_torch.exporting.description import Fmi, description, variables
from rotorid_torch.exporting.subject import Subject

FIXED = (1980, 1, 1, 0, 0, 0)
"""Date of the archive's files: the same model gives the same bytes."""
FACTS = "resources/model.json"
"""What rotorid itself wants of an FMU: names, units, reference, ranges."""


def write_fmu(subject: Subject, path: Path, fmi: Fmi = Fmi.TWO) -> None:
    """Write the FMU.

    Raises InputError: there is no C compiler, or the model has no form in C.
    """
    source = c_source(subject.model, subject.title, subject.step)
    guid = hashlib.sha256(f"{fmi.value}{source.header}{source.source}".encode()).hexdigest()[:32]
    listed = variables(subject.model, subject.spec.control_units, subject.step, fmi)
    identity = {"name": subject.title, "file": source.name, "guid": f"{{{guid}}}", "tool": subject.tool}
    identity["description"] = f"{subject.title}, identified from flight data; free of Python"
    sources = _sources(source, fmi, identity["guid"])
    files = {"modelDescription.xml": description(listed, fmi, identity, subject.step)}
    files |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    if fmi is Fmi.THREE:
        files["sources/buildDescription.xml"] = _build_description(source.name)
    files[FACTS] = json.dumps(_facts(subject), indent=1).encode()
    files[f"binaries/{_system(fmi)}/{source.name}{suffix()}"] = _compiled(sources, source.name, fmi)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(files.items(), key=lambda f: (f[0] != "modelDescription.xml", f[0])):
            archive.writestr(zipfile.ZipInfo(name, FIXED), content, zipfile.ZIP_DEFLATED)


def _sources(source: ModelSource, fmi: Fmi, guid: str) -> dict[str, str]:
    """The C files by name: the model, and the interface about it."""
    interface = {}
    for name in ("fmu.c", f"fmi{fmi.value[0]}.c"):
        text = (RUNTIME / name).read_text()
        text = text.replace('"rid.h"', f'"{source.name}.h"').replace("RID_GUID", f'"{guid}"')
        interface[name] = text.replace("RID_", f"{source.name.upper()}_").replace("rid_", f"{source.name}_")
    return {f"{source.name}.h": source.header, f"{source.name}.c": source.source, **interface}


def _compiled(sources: Mapping[str, str], name: str, fmi: Fmi) -> bytes:
    with scratch_folder() as folder:
        for file, text in sources.items():
            (folder / file).write_text(text)
        out = folder / f"{name}{suffix()}"
        library([folder / f"fmi{fmi.value[0]}.c", folder / f"{name}.c"], out)
        return out.read_bytes()


def _system(fmi: Fmi) -> str:
    """Folder of this machine in the archive, as each version of FMI calls it."""
    system, machine = platform.system(), platform.machine().lower()
    if fmi is Fmi.TWO:
        kind = {"Windows": "win", "Darwin": "darwin"}.get(system, "linux")
        return f"{kind}{64 if sys.maxsize > 2**32 else 32}"
    kind = {"Windows": "windows", "Darwin": "darwin"}.get(system, "linux")
    return f"{ {'amd64': 'x86_64', 'arm64': 'aarch64'}.get(machine, machine) }-{kind}"


def _build_description(name: str) -> bytes:
    """Which sources make the library (FMI 3.0, sec. 2.5.1.2)."""
    files = "".join(f'<SourceFile name="{f}"/>' for f in ("fmi3.c", f"{name}.c"))
    build = f'<BuildConfiguration modelIdentifier="{name}"><SourceFileSet language="C99">{files}</SourceFileSet>'
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">'
    return f"{head}{build}</BuildConfiguration></fmiBuildDescription>\n".encode()


def _facts(subject: Subject) -> dict[str, Any]:
    model, spec = subject.model, subject.spec
    body = len(model.body.states)
    return {
        "format": 1,
        "title": subject.title,
        "body": model.body.states,
        "states": [{"name": s.name, "unit": s.unit, "channel": s.channel} for s in model.layout.states],
        "settled": [s.name for s in model.layout.states[body:] if s.channel is None],
        "controls": model.body.controls,
        "outputs": model.body.outputs,
        "reference": {n: model.reference.get(n, 0.0) for n in (*model.layout.names, *model.body.controls)},
        "ranges": spec.ranges,
    }
