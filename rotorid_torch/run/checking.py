"""What `rotorid check` found, for people, and as a run of its own."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from rotorid_torch.data.check import Check
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.finding import Finding
from rotorid_torch.run.folder import run_folder
from rotorid_torch.run.monitor import Monitor, peak_memory_mb
from rotorid_torch.run.records import DatasetRecord, Report
from rotorid_torch.run.write import write_report


def check_table(found: Check) -> Table:
    """All findings, gravest first."""
    verdict = "fit for identification" if found.fit else "not fit for identification"
    table = Table("", "where", "finding", title=f"{found.dataset}: {verdict}", title_justify="left")
    for finding in found.findings:
        table.add_row(finding.severity, _where(finding), finding.sentence)
    return table


def write_check(out: Path, dataset: Dataset, found: Check, seed: int, monitor: Monitor) -> None:
    """Write the findings as a run: errors and warnings become the report's warnings, all of them go to log.txt."""
    grave = [*found.of("error"), *found.of("warning")]
    with run_folder(out) as folder, monitor.recording(folder):
        for finding in found.findings:
            monitor.log(f"{finding.severity}: {_told(finding)}")
        report = Report(
            command="check",
            dataset=DatasetRecord(name=dataset.name, sha256=dataset.sha256),
            seed=seed,
            time_s=monitor.time_record(),
            peak_memory_mb=peak_memory_mb(),
            before=None,
            warnings=tuple(_told(finding) for finding in grave),
        )
        write_report(folder, report)


def _where(finding: Finding) -> str:
    return " ".join(part for part in (finding.flight, finding.channel) if part)


def _told(finding: Finding) -> str:
    where = _where(finding)
    return f"{where}: {finding.sentence}" if where else finding.sentence
