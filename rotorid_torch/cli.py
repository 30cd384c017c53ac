"""The command line: parser and exit codes only; each command's module is imported inside its function.

Exit codes: 0 done; 2 bad input or usage, one line on stderr; 3 (`check` alone) not usable; 130 interrupted; 1 anything
else, one line and a log.
"""

from __future__ import annotations

import argparse
import atexit
import io
import json
import math
import os
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rotorid_torch.core.processes.loading import loading
from rotorid_torch.core.storage.atomic import OUTPUT, Unwritable, reason, writing
from rotorid_torch.errors import InputError, LostRank, OutsideRange, ReportedElsewhere, nearest
from rotorid_torch.printable import printable
from rotorid_torch.version import __version__

if TYPE_CHECKING:
    from rich.console import Console

    from rotorid_torch.run.output.monitor import Monitor

Options = argparse.Namespace
NOT_FIT = 3
"""Exit code of `check` where no model can be identified from a data set."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are InputErrors, so that usage errors are one line like all others."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError instead of printing the usage."""
        raise InputError(self.prog, "", message, f"what {self.prog} --help lists")

    def parse_known_args(self, args=None, namespace=None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """As argparse does, but an option that its command has not is an error, with the nearest name, before all."""
        options = [option for action in self._actions for option in action.option_strings]
        words = [str(word).split("=")[0] for word in args or ()]
        wrong = [word for word in words if word.startswith("--") and word not in options and word != "--"]
        if wrong and self._subparsers is None:
            self.error(f"there is no option {wrong[0]}{nearest(wrong[0], options)}")
        return super().parse_known_args(args, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """As argparse does, with the nearest of the choices."""
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices]
            what = action.metavar or "/".join(action.option_strings)
            self.error(f"{what}: there is no '{value}'{nearest(str(value), choices)}, only {', '.join(choices)}")


class AddEffect(argparse.Action):
    """`--effect ID`: begins a further effect, with no size yet."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        """Append (ID, None) to the list of effects."""
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or []), (values, None)])


class SizeLastEffect(argparse.Action):
    """`--size F`: the size of the effect named just before it."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        """Put the size into the last pair."""
        effects = list(namespace.effect or [])
        if not effects or effects[-1][1] is not None:
            parser.error("--size without an --effect before it")
        namespace.effect = [*effects[:-1], (effects[-1][0], values)]


EXAMPLES = """\
three ways to begin:
  rotorid fly --out FLIGHTS --effect control.delay     fly the built-in aircraft, with a late control to find
  rotorid import flight.ulg --out FLIGHTS              or bring a log of PX4, ArduPilot or Betaflight, or a table
  rotorid close-loop FLIGHTS --out RUN                 a model, what it lacks by name, and RUN/report.html
"""
PROFILED = 40
"""Functions that a profile shows."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; `--help` leaves by SystemExit(0), as argparse does.

    Without arguments the command is that of the process, which ends with it. It ends at once: Python would take a
    million objects apart first, which takes half a second.
    """
    if arguments is not None:
        return _run(arguments)
    code = _run(sys.argv[1:])
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run(words: Sequence[str]) -> int:
    os.environ.setdefault("ROTORID_THREADS", os.environ.get("OMP_NUM_THREADS", ""))  # native loops: all processors
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # read by torch on import; many small steps are fastest on one thread
    # torch's compiler, which some derivatives import and none uses, would leave a folder of its own in this one
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", os.environ.get("TMPDIR") or "/tmp")
    os.environ.setdefault("TORCH_CPP_LOG_LEVEL", "ERROR")  # what torch remarks on lost processes, our line says better
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal of another encoding than UTF-8 gets other signs
    speaks = os.environ.get("RANK", "0") == "0"  # under torchrun all processes refuse the same usage
    try:
        with _interrupted_by(signal.SIGTERM, signal.SIGHUP), warnings.catch_warnings():
            warnings.showwarning = lambda *message, **more: None  # stderr is for our line; a monitor logs them
            options = parser().parse_args(words or ["--help"])
            _refuse_missing_device(options.device)
            speaks = True
            code = _profiled(options) if options.profile else options.run(options)
            with writing(OUTPUT):
                sys.stdout.flush()
    except ReportedElsewhere as elsewhere:
        return _code(elsewhere.error)
    except BrokenPipeError:
        _print_no_more()
        return 1
    except (Exception, KeyboardInterrupt) as error:
        if speaks:
            line = printable(" ".join(_sentence(error).split()), layout=False)
            print(line if line.startswith("rotorid ") else f"rotorid: {line}", file=sys.stderr)
        if isinstance(error, Unwritable) and error.file == OUTPUT:
            _print_no_more()
        return _code(error)
    return code or 0


def _profiled(options: Options) -> int | None:
    """Run a command, and print the functions of the package that took most of the time, with what they call."""
    import cProfile
    import pstats

    profile = cProfile.Profile()
    try:
        return profile.runcall(options.run, options)
    finally:
        stats = pstats.Stats(profile).stats  # pyright: ignore[reportAttributeAccessIssue]
        rows = [(line[3], line[0], file, name) for (file, _, name), line in stats.items() if "rotorid_torch" in file]
        print("seconds    calls  function", file=sys.stderr)
        for seconds, calls, file, name in sorted(rows, reverse=True)[:PROFILED]:
            place = file.rpartition("rotorid_torch/")[2].removesuffix(".py").replace("/", ".")
            print(f"{seconds:7.2f} {calls:8d}  {place}.{name}", file=sys.stderr)


def _print_no_more() -> None:
    """What is left to be printed goes nowhere: it would fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _code(error: BaseException) -> int:
    """Exit code of what ended a command."""
    bad_input = isinstance(error, InputError) or (isinstance(error, OSError) and error.filename is not None)
    return 2 if bad_input else 130 if isinstance(error, KeyboardInterrupt) else 1


def _sentence(error: BaseException) -> str:
    """The line for people."""
    if isinstance(error, InputError | LostRank):
        return str(error)
    if isinstance(error, KeyboardInterrupt):
        several = int(os.environ.get("WORLD_SIZE", "1")) > 1
        return "interrupted; torchrun does so when a process of the run is lost" if several else "interrupted"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{os.fsdecode(error.filename)}: cannot be used ({reason(error)}); expected a place that can be"
    return f"unexpected {type(error).__name__}: {error}; the log is {_write_log(error)}"


def parser() -> Parser:
    """The parser of all commands."""
    top = Parser(
        prog="rotorid",
        description="Identify rotorcraft models from flight data.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    top.add_argument(
        "--version", action="version", version=f"rotorid {__version__}", help="print the version and leave"
    )
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    _add_fly(commands)
    _add_import(commands)
    _add_check(commands)
    _add_run(_add_command(commands, "reconstruct", reconstruct, "step 1 alone: forces and moments over time"))
    _add_identify(commands)
    _add_close_loop(commands)
    _add_simulate(commands)
    _add_export(commands)
    _add_command(commands, "effects", effects, "the table of effects that a model can hold")
    show_parser = _add_command(commands, "show", show, "look at runs and compare them, in a browser or as text")
    show_parser.add_argument(
        "--text", action="store_true", help="print scorecards; where nobody looks on, it does so too"
    )
    show_parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="folder of a run")
    doctor_parser = _add_command(commands, "doctor", doctor, "versions, threads, devices and cache; what is missing")
    doctor_parser.add_argument("--empty-cache", action="store_true", help="remove what is kept between runs")
    return top


def _add_command(commands, name: str, run: Callable[[Options], int | None], about: str) -> argparse.ArgumentParser:
    description = about[0].upper() + about[1:] + ("" if about.endswith("?") else ".")
    command = commands.add_parser(name, help=about, description=description, allow_abbrev=False)
    command.set_defaults(run=run)
    common = command.add_argument_group("every command")
    common.add_argument("--quiet", action="store_true", help="print nothing but errors")
    common.add_argument("--verbose", action="store_true", help="also print what log.txt holds: every fit, every step")
    common.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    seed_help = "seed of flights, noise, clean aircraft, residuals by chance and network starts (0)"
    common.add_argument("--seed", type=_seed, default=0, metavar="N", help=seed_help)
    common.add_argument("--profile", action="store_true", help="print where the time went, to standard error")
    common.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where torch computes (cpu)")
    return command


def _add_dataset(command: argparse.ArgumentParser) -> None:
    command.add_argument("dataset", metavar="DATASET", type=Path, help="folder of the data set, with its dataset.toml")


def _add_run(command: argparse.ArgumentParser) -> None:
    """From a data set to a RUN."""
    _add_dataset(command)
    command.add_argument("--out", metavar="RUN", type=Path, required=True, help="the run's folder")


def _add_fly(commands) -> None:
    command = _add_command(commands, "fly", fly, "fly the built-in flight-test aircraft; writes a data set")
    command.add_argument("--out", metavar="DATASET", type=Path, required=True, help="folder to write")
    command.add_argument("--effect", metavar="ID", action=AddEffect, help="hide this effect; repeatable")
    size_help = "size of the effect before it, as a factor of its typical size (1)"
    command.add_argument("--size", metavar="F", type=_number, action=SizeLastEffect, help=size_help)
    command.add_argument(
        "--speed", metavar="V", type=_number, help="trimmed speed, m/s (hover); of a multirotor's figures"
    )
    command.add_argument("--heading", metavar="PSI", type=_number, help="heading of the trim, rad (0)")
    command.add_argument(
        "--height", metavar="H", type=_number, help="height of the trim, m (27.4; a multirotor's goes with its size)"
    )
    vehicle_help = (
        "another vehicle: declared in a TOML file; or quad, or multirotor-N, the Nth multirotor drawn at random"
    )
    command.add_argument("--vehicle", metavar="FILE", help=vehicle_help)
    flights_help = "names with commas, also under a condition: dbl_lon_p, dbl_lon_p-90deg, dbl_col_p-5m, "
    flights_help += "dbl_lon_p-20mps; or all, headings, heights, speeds (all, and what the effects need)"
    command.add_argument("--flights", metavar="LIST", type=_names, help=flights_help)


def _add_import(commands) -> None:
    command = _add_command(commands, "import", import_logs, "flight logs and tables in; writes a data set")
    command.add_argument("logs", metavar="LOG", nargs="+", type=Path, help=".ulg, .bin, .mat, .csv, .parquet or .npz")
    command.add_argument("--out", metavar="DATASET", type=Path, required=True, help="folder to write")
    command.add_argument("--map", metavar="MAP.toml", type=Path, help="which fields are which channels (built in)")
    command.add_argument("--rate", metavar="HZ", type=_number, help="sample rate (that of the body rates, at most 250)")
    command.add_argument("--split", action="store_true", help="cut into manoeuvres by control activity")


def _add_check(commands) -> None:
    command = _add_command(commands, "check", check, "can a model be identified from it: ready, limited or not usable")
    _add_dataset(command)
    command.add_argument("--out", metavar="RUN", type=Path, help="also write the findings as a run")


def _add_identify(commands) -> None:
    command = _add_command(commands, "identify", identify, "the three steps, validation and report")
    _add_run(command)
    command.add_argument("--effect", metavar="ID", action="append", default=[], help="add this effect; repeatable")
    method_help = (
        "of step 3: output-error, filter-error (where the air moves), or auto, which looks at the flights (auto)"
    )
    methods = ("auto", "output-error", "filter-error")
    command.add_argument("--method", choices=methods, default="auto", help=method_help)
    command.add_argument("--resume", action="store_true", help="go on from an interrupted run's last finished step")


def _add_close_loop(commands) -> None:
    command = _add_command(commands, "close-loop", close_loop, "identify, trace what is missing, identify again")
    _add_run(command)
    command.add_argument("--hybrid", action="store_true", help="a small network learns what no named effect explains")


def _add_simulate(commands) -> None:
    command = _add_command(commands, "simulate", simulate, "free run of a model on a flight")
    command.add_argument("model", metavar="MODEL", type=Path, help="a RUN, its model.pt, or an FMU of it")
    _add_dataset(command)
    command.add_argument("--flight", metavar="NAME", required=True, help="whose controls the model flies by")
    command.add_argument("--out", metavar="FILE", type=Path, required=True, help="FILE.npz or FILE.csv to write")
    command.add_argument("--start", metavar="S", type=_number, default=0.0, help="where in the flight to begin, s (0)")
    command.add_argument("--seconds", metavar="S", type=_number, help="how long to run, s (to the flight's end)")
    command.add_argument("--overwrite", action="store_true", help="replace FILE, whatever it is, but no input")


def _add_export(commands) -> None:
    command = _add_command(commands, "export", export, "the model of a run for other tools")
    command.add_argument("run_folder", metavar="RUN", type=Path, help="of identify or close-loop")
    fmu_help = "for co-simulation, with its C sources; needs a C compiler"
    command.add_argument("--fmu", metavar="FILE.fmu", type=Path, help=fmu_help)
    command.add_argument("--fmi", choices=("2.0", "3.0"), default="2.0", help="version of the FMU (2.0)")
    statespace_help = "A, B, C, D with names, units and trim: .json or .mat"
    command.add_argument("--statespace", metavar="FILE", type=Path, help=statespace_help)
    onnx_help = "derivative and output functions; needs the package onnx"
    command.add_argument("--onnx", metavar="FILE.onnx", type=Path, help=onnx_help)
    command.add_argument("--c", metavar="DIR", type=Path, help="header and source in C99")
    command.add_argument("--csv", metavar="FILE.csv", type=Path, help="the parameters as a table")
    command.add_argument("--overwrite", action="store_true", help="replace what is in the way")


def fly(options: Options) -> None:
    """Fly the built-in aircraft and write a data set."""
    from rotorid_torch.simulation import fly as fly_aircraft

    settings = {name: getattr(options, name) for name in ("speed", "heading", "height", "vehicle", "flights")}
    settings = {name: value for name, value in settings.items() if value is not None}
    monitor = _monitor(options)
    with monitor.step("fly"):
        fly_aircraft(
            options.out, seed=options.seed, effects=options.effect or (), progress=monitor.progress, **settings
        )
    _answer(options, {"dataset": str(options.out)}, f"data set: {options.out}\nNext: rotorid check {options.out}")


def import_logs(options: Options) -> None:
    """Turn logs into a data set."""
    from rotorid_torch.commands.import_log import import_record, import_table
    from rotorid_torch.importing import logs

    done = logs.import_log(options.logs, options.out, options.map, options.rate, options.split)
    _answer(options, import_record(done), import_table(done))


def check(options: Options) -> int:
    """Grade a data set: ready, limited or not usable; exit code 3 for the last."""
    with loading():
        from rotorid_torch.data import load
        from rotorid_torch.run.check import check as examine
        from rotorid_torch.run.check import check_table, write_check
        from rotorid_torch.run.output.folder import refuse_unless_free

    if options.out:
        refuse_unless_free(options.out, "check")
    dataset = load(options.dataset)
    grading = examine(dataset)
    if options.out:
        write_check(options.out, dataset, grading, options.seed, _monitor(options))
    from rich.console import Group

    parts = [check_table(grading, options.dataset), *([_where(options.out)] if options.out else [])]
    _answer(options, grading.to_dict(), Group(*parts))
    return 0 if grading.fit else NOT_FIT


def reconstruct(options: Options) -> None:
    """Step 1 alone."""
    with loading():
        from rotorid_torch.data import load
        from rotorid_torch.run import pipeline
        from rotorid_torch.run.output.folder import refuse_unless_free

    refuse_unless_free(options.out, "reconstruct")
    pipeline.reconstruct(load(options.dataset), options.out, seed=options.seed, monitor=_monitor(options))
    _answer_report(options)


def identify(options: Options) -> None:
    """The three steps, validation and report; under torchrun, by all processes together."""
    with loading():
        from rotorid_torch.core.processes.ranks import ranks_of_torchrun
        from rotorid_torch.data import load
        from rotorid_torch.run import pipeline
        from rotorid_torch.run.output.folder import refuse_unless_free

    with ranks_of_torchrun() as ranks:
        refuse_unless_free(options.out, "identify")
        settings = {"effects": tuple(options.effect), "seed": options.seed, "device": options.device}
        settings["method"] = options.method
        monitor = _monitor(options) if ranks.first else None
        dataset = load(options.dataset)
        pipeline.identify(dataset, out=options.out, monitor=monitor, resume=options.resume, ranks=ranks, **settings)
        if ranks.first:
            _answer_report(options)


def close_loop(options: Options) -> None:
    """Find what the model lacks, name it, add it, identify again; under torchrun, by all processes together."""
    with loading():
        from rotorid_torch.core.processes.ranks import PATIENCE_FOR_FITS_S, ranks_of_torchrun
        from rotorid_torch.data import load
        from rotorid_torch.run.close_loop import close_loop as close
        from rotorid_torch.run.output.folder import refuse_unless_free

    with ranks_of_torchrun(PATIENCE_FOR_FITS_S) as ranks:
        refuse_unless_free(options.out, "close-loop")
        settings = {"hybrid": options.hybrid, "seed": options.seed, "device": options.device}
        monitor = _monitor(options) if ranks.first else None
        close(load(options.dataset), out=options.out, monitor=monitor, ranks=ranks, **settings)
        if ranks.first:
            _answer_report(options)


def simulate(options: Options) -> None:
    """Free run of a model on a flight."""
    from rich.console import Group

    from rotorid_torch.data import load
    from rotorid_torch.report.scorecard import fidelity_table
    from rotorid_torch.run import saved_model
    from rotorid_torch.run.output.folder import refuse_unless_free_run
    from rotorid_torch.validate.free_run import fidelity

    refuse_unless_free_run(options.out, overwrite=options.overwrite)
    piece = saved_model.Stretch(options.start, options.seconds)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        data = load(options.dataset)
        how = {"overwrite": options.overwrite}
        free = saved_model.write_free_run(options.model, data, options.flight, options.out, piece, **how)
    followed = fidelity(free, data.flights[options.flight])
    sentences = [str(warning.message) for warning in caught if warning.category in (UserWarning, OutsideRange)]
    lines = [f"free run: {options.out}", *(f"warning: {sentence}" for sentence in sentences)]
    answer = {"file": str(options.out), "warnings": sentences, "channels": followed}
    _answer(options, answer, Group(fidelity_table(followed), "\n".join(lines)))


def export(options: Options) -> None:
    """Write the model of a run for other tools."""
    from rotorid_torch.exporting.targets import TARGETS
    from rotorid_torch.run.saved_model import open_run

    places = {target: getattr(options, target) for target in TARGETS}
    places = {target: place for target, place in places.items() if place is not None}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        written = open_run(options.run_folder).export(fmi=options.fmi, overwrite=options.overwrite, **places)
    sentences = [str(warning.message) for warning in caught if warning.category is UserWarning]
    lines = [*(f"{target}: {place}" for target, place in written.items()), *(f"warning: {s}" for s in sentences)]
    answer = {target: str(place) for target, place in written.items()}
    _answer(options, answer | ({"warnings": sentences} if sentences else {}), "\n".join(lines))


def effects(options: Options) -> None:
    """Print the table of effects."""
    from rotorid_torch.commands.effects_table import effect_rows, effects_table
    from rotorid_torch.effects.registry import registered

    rows = effect_rows(registered().values())
    _answer(options, {"effects": rows}, effects_table(rows))


def show(options: Options) -> None:
    """Serve runs on loopback where a terminal looks on, else print their scorecards."""
    import msgspec
    from rich.console import Group

    from rotorid_torch.report.records import read_report
    from rotorid_torch.report.scorecard import scorecard

    reports = {str(run): read_report(run) for run in options.runs}
    if not (options.text or options.json or options.quiet) and sys.stdout.isatty():
        from rotorid_torch.commands.show import serve

        serve(reports)
        return
    parts = [part for run, report in reports.items() for part in (scorecard(report, run=Path(run)), _where(Path(run)))]
    _answer(options, {"runs": msgspec.to_builtins(reports)}, Group(*parts))


def doctor(options: Options) -> None:
    """Print versions, threads, devices and the cache, emptied first where that is asked for."""
    from rotorid_torch.commands.doctor import findings, table
    from rotorid_torch.core.storage import cache

    removed = cache.empty() if options.empty_cache else None
    state = findings(removed)
    _answer(options, state, table(state))


def _answer(options: Options, as_json: object, for_people: object) -> None:
    """Print one JSON object, or something for people, or with --quiet nothing."""
    if options.json:
        import msgspec

        with writing(OUTPUT):
            print(json.dumps(_finite(msgspec.to_builtins(as_json, str_keys=True))))  # in ASCII: no terminal obeys it
    elif not options.quiet:
        _console().print(for_people)


def _answer_report(options: Options) -> None:
    from rich.console import Group

    from rotorid_torch.report.records import read_report
    from rotorid_torch.report.scorecard import scorecard

    report = read_report(options.out)
    _answer(options, report, Group(scorecard(report, options.dataset, options.out), _where(options.out)))


def _where(run: Path) -> str:
    return f"report: {run.absolute() / 'report.html'}"


def _console() -> Console:
    from rotorid_torch.commands.console import PlainConsole

    return PlainConsole()


def _finite(value: Any) -> Any:
    """The same with None for numbers that JSON has not; names of files may be no Unicode."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list | tuple) else value


def _monitor(options: Options) -> Monitor:
    from rotorid_torch.run.output.monitor import Monitor

    return Monitor(None if options.quiet or options.json else _console(), verbose=options.verbose)


def _refuse_missing_device(device: str) -> None:
    if device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise InputError("--device", device, "no CUDA device is available here", "cpu")


@contextmanager
def _interrupted_by(*signals: signal.Signals) -> Iterator[None]:
    """Let these signals end the block as Ctrl-C does, so that everything half-written is removed."""

    def interrupt(number: int, frame: object) -> NoReturn:
        raise KeyboardInterrupt

    earlier = {number: signal.signal(number, interrupt) for number in signals}
    try:
        yield
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


def _write_log(error: BaseException) -> str:
    try:
        with tempfile.NamedTemporaryFile("w", prefix="rotorid-", suffix=".log", delete=False) as file:
            traceback.print_exception(error, file=file)
    except OSError as refused:
        return f"lost ({reason(refused)})"
    return file.name


def _seed(text: str) -> int:
    if not text.isdecimal() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 on, of 18 digits at most")
    return int(text)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"'{text}' is not a finite number")
    return value


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())
