"""Motors of PX4: commands from the faster of their sources, by what each output drives; rotor speeds by motor.

Source: PX4 Guide, "Actuator Configuration and Testing" (PREFIX_FUNCn, actuator_outputs by driver); msg/EscStatus.msg.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing.signals.mapping import Entry
from rotorid_torch.importing.signals.outputs import TWO_WAYS, of_px4, range_of
from rotorid_torch.importing.signals.plan import FASTER, Chosen, Group, moving, named, rate_of
from rotorid_torch.importing.signals.streams import Log, Stream, is_numbers

MOTORS, PULSES, OLDER, ESC = "actuator_motors", "actuator_outputs", "OUT0", "esc_status"
SIMULATED = "actuator_outputs_sim"
MOST = 12
WIRED = ("PWM_MAIN", "PWM_AUX", "UAVCAN_EC", "HIL_ACT", "PCA9685", "SIM_GZ_EC")
"""Groups of outputs in the order in which their drivers publish; others follow."""
FIRST_MOTOR = 101
"""Function of the first motor; a setting PREFIX_FUNCn says what output n of a group drives."""
IN_BETAFLIGHTS_ORDER = {1: 2, 2: 3, 3: 4, 4: 1}
"""Output of each motor by MOT_ORDERING 1, of firmware before functions of outputs."""
FUNCTION = re.compile(r"(\w+)_FUNC(\d+)")
FIELDS = {
    MOTORS: [f"control[{i}]" for i in range(MOST)],
    **{topic: [f"output[{i}]" for i in range(16)] for topic in (PULSES, SIMULATED)},
    OLDER: [f"Out{i}" for i in range(8)],
    ESC: [f"esc[{i}].{name}" for i in range(MOST) for name in ("esc_rpm", "actuator_function")],
}
"""Fields that are needed, by topic."""


@dataclass(frozen=True)
class Wiring:
    """A group of outputs (`PWM_MAIN`, ...) and the output, from 1, of each motor that it drives; empty if not set."""

    prefix: str = ""
    outputs: Mapping[int, int] = field(default_factory=dict)


def motors(log: Log, number: int) -> tuple[Chosen, str]:
    """Motor commands 0 to 1 from the faster of their sources, and the group that drives most motors.

    `number` is that of the motors, 0 where no setting says it.
    """
    commands, groups = _commands(log, number), wirings(log.parameters)
    prefix = groups[0].prefix
    topic = next((t for t in (PULSES, SIMULATED, OLDER) if log.instances(t)), "")
    hertz = max((rate_of(log.streams[topic, i].time) for i in log.instances(topic)), default=0.0)
    moves = _moves(log, commands)
    if not topic or (moves and hertz <= FASTER * commands.hertz):
        return commands, prefix
    actuators = _from_outputs(log, topic, groups, number)
    if not commands.entries:
        return actuators, prefix
    if not _moves(log, actuators):
        return commands, prefix
    slower = f"{commands.hertz:.3g} Hz against {actuators.hertz:.3g} Hz"
    reason = f"{MOTORS} left: {slower if moves else 'never changes'}"
    return replace(actuators, reason="; ".join(filter(None, (actuators.reason, reason)))), prefix


def _moves(log: Log, chosen: Chosen) -> bool:
    """Whether any of the channels changes."""
    sources = [log.source(entry.field, channel) for channel, entry in chosen.entries.items()]
    return any(moving(log.stream(source).columns[source.field]) for source in sources)


def _commands(log: Log, number: int) -> Chosen:
    """Commands as the control allocation gave them; one that is never a number drives nothing."""
    if not log.instances(MOTORS):
        return Chosen()
    instance = log.instances(MOTORS)[0]
    stream = log.streams[MOTORS, instance]
    logged = {i: stream.columns[name] for i in range(MOST) if (name := f"control[{i}]") in stream.columns}
    used = [i for i, values in logged.items() if is_numbers(values) and np.isfinite(values).any()]
    motors = {f"motor{i + 1}": Entry(f"control[{i}]", "norm") for i in used[: number or MOST]}
    return Chosen(named(Group(MOTORS, motors), instance), rate_of(stream.time))


def wirings(settings: Mapping[str, float]) -> list[Wiring]:
    """Groups of outputs that drive motors, that of most first; of each further one the motors that are still free."""
    groups: dict[str, dict[int, int]] = {prefix: {} for prefix in WIRED}
    for key, value in settings.items():
        match = FUNCTION.fullmatch(key)
        if match and 0 <= (motor := int(value) - FIRST_MOTOR) < MOST:
            groups.setdefault(match[1], {})[motor + 1] = int(match[2])
    chosen, driven = list[Wiring](), set[int]()
    for prefix in sorted(groups, key=lambda prefix: -len(groups[prefix])):
        free = {motor: n for motor, n in sorted(groups[prefix].items()) if motor not in driven}
        chosen += [Wiring(prefix, free)] if free else []
        driven |= {*free}
    return chosen or [Wiring()]


def _from_outputs(log: Log, topic: str, groups: Sequence[Wiring], number: int) -> Chosen:
    """Commands from what the outputs were told, of every group from the instance that its driver publishes."""
    free, parts = log.instances(topic), list[Chosen]()
    for group in groups:
        if not free:
            motors = ", ".join(f"motor{motor}" for motor in group.outputs)
            parts.append(Chosen(missing=f"{motors} (no {topic} of {group.prefix})"))
            continue
        instance, reason = _instance(log, topic, group, number, free)
        free = [other for other in free if other != instance]
        parts.append(replace(_of_group(log, topic, instance, group, number), reason=reason))
    said = [part.reason for part in parts if part.reason] + [
        f"no data: {part.missing}" for part in parts if part.missing
    ]
    if not any(group.outputs for group in groups) and log.parameters.get("MOT_ORDERING") == 1:
        said.append("motors in Betaflight's order, by MOT_ORDERING 1")
    if not number and not any(group.outputs for group in groups):
        said.append("no setting says which output drives which motor: those that move are motors")
    reason = "; ".join(said)
    hertz = min(part.hertz for part in parts if part.entries)
    return Chosen({name: entry for part in parts for name, entry in part.entries.items()}, hertz, reason)


def _form(topic: str) -> str:
    return "Out{}" if topic == OLDER else "output[{}]"


def _instance(log: Log, topic: str, group: Wiring, number: int, free: Sequence[int]) -> tuple[int, str]:
    """Instance of the outputs in which most of a group move, and why, where there are several."""
    places = [n - 1 for n in group.outputs.values()]

    def stirred(instance: int) -> int:
        outputs = _outputs(log, topic, instance, number)
        return sum(map(moving, [outputs[i] for i in places if i < len(outputs)] or outputs[: number or 8]))

    counts = {instance: stirred(instance) for instance in free}
    later = group.prefix not in ("", WIRED[0])
    chosen = max(counts, key=lambda instance: (counts[instance], instance if later else -instance))
    if len(log.instances(topic)) < 2:
        return chosen, ""
    of_group = f" of {group.prefix}" if group.prefix else ""
    why = f"most outputs{of_group} move there" if counts[chosen] else "no output moves in any"
    return chosen, f"{topic} has instances {', '.join(map(str, log.instances(topic)))}: {chosen} is used ({why})"


def _of_group(log: Log, topic: str, instance: int, group: Wiring, number: int) -> Chosen:
    """Commands of the motors on one group, by the range of its protocol."""
    outputs = _outputs(log, topic, instance, number)
    count = number or sum(map(moving, outputs[:8])) or 4
    order = _order(log)
    driven = group.outputs or {m: order.get(m, m) for m in range(1, count + 1)}
    prefix = group.prefix or ("PWM_AUX" if instance == 1 else "PWM_MAIN")
    raw, entries = [outputs[n - 1] for n in driven.values() if n <= len(outputs)], dict[str, Entry]()
    for motor, output in driven.items():
        name = _form(topic).format(output - 1)
        key = f"{topic}.{name} (motor{motor})"
        if output > len(outputs):
            raise InputError(log.file, f"{topic}.{name}", "is missing", f"the output of motor {motor}")
        if reverse := _reversing(log.parameters, prefix, output):
            raise InputError(log.file, key, f"is reversed by {reverse}", "a map (--map) with scale and offset")
        fitting = range_of(log.file, key, outputs[output - 1], of_px4(log.parameters, prefix, output, raw))
        if fitting.about.startswith("DShot") and log.parameters.get("DSHOT_3D_ENABLE"):
            raise InputError(log.file, key, "turns both ways, by DSHOT_3D_ENABLE", TWO_WAYS)
        entries[f"motor{motor}"] = fitting.entry(name)
    return Chosen(named(Group(topic, entries), instance), rate_of(log.streams[topic, instance].time))


def _order(log: Log) -> dict[int, int]:
    """Output of each motor, where the settings say so."""
    return IN_BETAFLIGHTS_ORDER if log.parameters.get("MOT_ORDERING") == 1 else {}


def _reversing(settings: Mapping[str, float], prefix: str, output: int) -> str:
    """Setting that reverses an output: a bit of PREFIX_REV, or PREFIX_REVn of older firmware; empty without one."""
    mask, single = f"{prefix}_REV", f"{prefix}_REV{output}"
    return mask if int(settings.get(mask, 0)) >> (output - 1) & 1 else single if settings.get(single, 0.0) > 0.0 else ""


def _outputs(log: Log, topic: str, instance: int, number: int) -> list[np.ndarray]:
    """Outputs of one instance in a row. Raises InputError where one is missing before the last, or of so many."""
    form = _form(topic)
    columns = log.streams[topic, instance].columns
    logged = [i for i in range(16) if form.format(i) in columns and is_numbers(columns[form.format(i)])]
    count = max(number, 4, logged[-1] + 1 if logged else 0)
    if missing := next((form.format(i) for i in range(count) if i not in logged), ""):
        raise InputError(
            log.file, f"{topic}.{missing}", "is missing", f"outputs {form.format(0)} to {form.format(count - 1)}"
        )
    return [columns[form.format(i)] for i in range(count)]


def speeds(log: Log, prefix: str, number: int) -> tuple[Chosen, list[str]]:
    """Rotor speeds by motor: a speed controller belongs to the motor of its function, or of its output."""
    if not log.instances(ESC):
        return Chosen(missing=f"omega1 omega2 ... (no {ESC})"), []
    instance = max(log.instances(ESC), key=lambda one: (len(_turning(log.streams[ESC, one])), -one))
    stream, turning = log.streams[ESC, instance], _turning(log.streams[ESC, instance])
    motors = {i: _motor_of(log, stream, prefix, i) for i in turning}
    notes = [f"esc[{i}] drives no motor: its speed is left out" for i, motor in motors.items() if not motor]
    pairs = sorted((motor, i) for i, motor in motors.items() if motor and (not number or motor <= number))
    if len({motor for motor, _ in pairs}) < len(pairs):
        return Chosen(), [*notes, "two speed controllers name the same motor: rotor speeds are left out"]
    entries = {f"omega{motor}": Entry(f"esc[{i}].esc_rpm", "rpm") for motor, i in pairs}
    crossed = ", ".join(f"esc[{i}] is motor {motor}" for motor, i in pairs if motor != i + 1)
    return Chosen(named(Group(ESC, entries), instance), rate_of(stream.time), crossed), notes


def _turning(stream: Stream) -> list[int]:
    """Speed controllers whose speed changes."""
    return [i for i in range(MOST) if moving(stream.columns.get(f"esc[{i}].esc_rpm", np.zeros(1)))]


def _motor_of(log: Log, stream: Stream, prefix: str, index: int) -> int:
    """Motor (from 1) that a speed controller drives; 0 where it drives something else."""
    function = last(stream, f"esc[{index}].actuator_function")
    if not function and prefix:
        function = log.parameters.get(f"{prefix}_FUNC{index + 1}")
    if not function:
        order = {} if prefix else _order(log)
        return next((motor for motor, output in order.items() if output == index + 1), index + 1)
    motor = int(function) - FIRST_MOTOR + 1
    return motor if 1 <= motor <= MOST else 0


def last(stream: Stream, name: str) -> float | None:
    """The last value of a column that is not zero, or that is all there is; None without one."""
    values = stream.columns.get(name, np.empty(0))
    if not is_numbers(values) or not len(values):
        return None
    used = values[values != 0]
    return float(used[-1] if len(used) and name.endswith("_id") else values[-1])
