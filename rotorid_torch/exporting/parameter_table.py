"""The parameters as CSV: name, value, standard error, unit, bounds, status and what each is."""

import csv
from pathlib import Path

from rotorid_torch.exporting.subject import Subject

COLUMNS = ("name", "value", "standard_error", "unit", "lower", "upper", "status", "description")


def write_table(subject: Subject, path: Path) -> None:
    """Write one row a parameter; numbers with all their digits, empty where there is none."""
    parameters = subject.model.parameter_set.parameters
    records = {p.name: p for p in subject.parameters}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for p, value in zip(parameters, subject.model.theta.tolist(), strict=True):
            record = records.get(p.name)
            error, status = ("", "") if record is None else (record.se, record.status)
            writer.writerow([p.name, repr(value), error, p.unit, *p.bounds, status, p.doc])
