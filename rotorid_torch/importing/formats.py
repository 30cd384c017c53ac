"""Which reader reads which file, and the built-in map that belongs to what it read."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots import ardupilot, blackbox, px4
from rotorid_torch.importing.autopilots.dataflash import read_dataflash
from rotorid_torch.importing.autopilots.dataflash_text import read_text_or_dataflash
from rotorid_torch.importing.autopilots.ulog import read_ulog
from rotorid_torch.importing.signals.mapping import Clock, Form
from rotorid_torch.importing.signals.plan import Plan
from rotorid_torch.importing.signals.streams import TOLD, Choose, Log
from rotorid_torch.importing.tables import sidpac
from rotorid_torch.importing.tables.arrays import read_matlab, read_npz, read_parquet
from rotorid_torch.importing.tables.columns import own_entries, own_plan
from rotorid_torch.importing.tables.csv import read_csv

FLIGHT_LOGS: Mapping[str, Callable[[Path, Choose], Log]] = {
    ".ulg": read_ulog,
    ".ulog": read_ulog,
    ".bin": read_dataflash,
    ".px4log": read_dataflash,
    ".log": read_text_or_dataflash,
}
"""Readers of logs with topics and clocks of their own, by the file's ending in small letters."""
TEXTS = (".csv", ".txt", ".tsv", ".asc", ".dat")
"""Endings of tables of text."""
TABLES: Mapping[str, Callable[[Path, Choose, Clock | None], Log]] = {
    **dict.fromkeys(TEXTS, read_csv),
    ".npz": read_npz,
    ".mat": read_matlab,
    ".parquet": read_parquet,
}
"""Readers of tables."""
DECODED = "the .csv that blackbox_decode or Betaflight's explorer makes of it"
UNPACKED = "the log that is packed in it"
AS_TABLE = "its topics as .csv"
CONVERTED: Mapping[str, str] = {
    **dict.fromkeys((".bbl", ".bfl", ".bbs"), DECODED),
    **dict.fromkeys((".zip", ".gz", ".7z", ".tar", ".xz"), UNPACKED),
    **dict.fromkeys((".bag", ".mcap", ".db3"), AS_TABLE),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "the sheet saved as .csv"),
    **dict.fromkeys((".tlog", ".rlog"), "the autopilot's log of its card: .bin of ArduPilot, .ulg of PX4"),
}
"""What to bring instead of files that only other programs read, by their endings."""


def read_log(file: Path, choose: Choose, clock: Clock | None, form: Form | None = None) -> Log:
    """Read a file by the reader of its ending; `form` is of a table of text. Raises InputError."""
    ending = file.suffix.lower()
    open_file(file, "a log").close()  # before its ending is judged
    try:
        if ending in FLIGHT_LOGS:
            return FLIGHT_LOGS[ending](file, choose)
        if ending in TEXTS:
            return read_csv(file, choose, clock, form=form)
        if ending in TABLES:
            return TABLES[ending](file, choose, clock)
    except OSError as error:
        raise InputError(file, "", f"cannot be read ({error.strerror or error})", "a readable file") from None
    if ending in CONVERTED:
        raise InputError(file, "", f"is a '{ending}', which no reader reads", CONVERTED[ending])
    endings = ", ".join((*FLIGHT_LOGS, *TABLES))
    raise InputError(file, "", f"has the ending '{ending}', which no reader reads", f"one of {endings}")


def built_in_fields(topic: str, names: list[str]) -> list[str]:
    """Fields that any built-in map may need: a reader's choice where there is no map."""
    return [
        *blackbox.fields(topic, names),
        *sidpac.fields(topic, names),
        *px4.fields(topic, names),
        *ardupilot.fields(topic, names),
        *own_fields(topic, names),
    ]


def own_fields(topic: str, names: list[str]) -> list[str]:
    """Columns that are named as our channels are."""
    return [entry.field.removeprefix(f"{topic}.") for entry in own_entries({topic: names}).values()]


PLANS: Mapping[str, Callable[[Log], Plan]] = {
    "PX4": px4.plan,
    "ArduPilot": ardupilot.plan,
    sidpac.SYSTEM: sidpac.plan,
    blackbox.SYSTEM: blackbox.plan,
}
"""By the log's maker; a table has that of its own names."""


def built_in_plan(log: Log) -> Plan:
    """Channels of a log by the map of its maker, or by their own names in a table. Raises InputError."""
    plan_of = PLANS.get(log.system, own_plan)
    plan = plan_of(log)
    return replace(plan, notes=(*plan.notes, *_changes(log, plan, plan_of)))


def _changes(log: Log, plan: Plan, plan_of: Callable[[Log], Plan]) -> list[str]:
    """A sentence on settings that changed while it was logged, if by what they were first the plan is another."""

    def differs(earlier: Mapping[str, float]) -> bool:
        try:
            other = plan_of(replace(log, parameters={**log.parameters, **earlier}))
        except InputError:
            return True
        return (other.kind, other.entries, other.vehicle) != (plan.kind, plan.entries, plan.vehicle)

    changed = {key: first for key, first in log.earlier.items() if first != log.parameters[key]}
    if not changed or not differs(changed):
        return []
    said = [f"{k} ({first:g}, then {log.parameters[k]:g})" for k, first in changed.items() if differs({k: first})]
    listed = f"{', '.join(said[:TOLD])}{f' and {len(said) - TOLD} more' if len(said) > TOLD else ''}"
    return [f"settings change while it is logged, and with them what is flown: the last are taken, of {listed}"]
