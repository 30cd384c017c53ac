"""What an output of an autopilot means: the range that its protocol and settings give, never a guess by its size.

Source: PX4 Guide, "Actuator Configuration" and parameters PWM_MAIN_MINn, PWM_MAIN_TIMn, DSHOT_CONFIG, UAVCAN_ENABLE;
ArduPilot, parameters MOT_PWM_TYPE, MOT_PWM_MIN, MOT_PWM_MAX, SERVO_BLH_3DMASK; Betaflight, "DSHOT - ESC Protocol".
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing.signals.mapping import Entry

SLACK = 0.1
"""Share of a range by which outputs may lie outside: a trim, a spin-up, an idle below the least command."""
REST_LEVELS = 3
"""Different values below a range that are levels of rest (disarmed, failsafe), not commands."""
LEAST_PULSE = 800.0
"""us: shorter ones no servo has, and motors that are told by counts rest far below that."""
STRAY = 0.01
"""Share of samples that may lie outside: single damaged ones become missing samples."""


@dataclass(frozen=True)
class OutputRange:
    """Outputs that stand for commands 0 and 1, and what says so.

    reached : share of the range that the largest output has at least; where no setting names the range, it must fit.
    """

    low: float
    high: float
    about: str
    reached: float = 0.0

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} ({self.about})"

    def holds(self, values: np.ndarray) -> bool:
        """Whether outputs (T,) lie inside, but for levels of rest and single damaged samples."""
        if self.reached and float(values.max(initial=-np.inf)) < self.low + self.reached * (self.high - self.low):
            return False
        return beyond(values, self.low, self.high) <= STRAY * len(values)

    def entry(self, field: str) -> Entry:
        """Motor command 0 to 1 from a field."""
        span = self.high - self.low
        return Entry(field, "norm", 1, 1.0 / span, -self.low / span)


TWO_WAYS = "motors that turn one way, or a map (--map) with scale and offset of each motor"
"""What is expected where a protocol has two halves, one for each way: its counts do not grow with the thrust."""
OF_THE_SERVO, ABOUT_A_TRIM = 8, 9
"""MOT_PWM_TYPE of motors with the range of their servo output, from its end or about its trim."""
DIGITAL = (4, 5, 6, 7)
"""MOT_PWM_TYPE and SERVO_BLH_OTYPE of DShot, 150 to 1200."""
UNIT = OutputRange(0.0, 1.0, "commands 0 to 1")
DSHOT = OutputRange(1.0, 1999.0, "DShot")
DSHOT_RAW = OutputRange(48.0, 2047.0, "DShot with the first 48 values for orders", reached=0.1)
UAVCAN = OutputRange(1.0, 8191.0, "UAVCAN")
SPEEDS = OutputRange(0.0, 1000.0, "speeds of a simulator in rad/s, by default")
PULSE = OutputRange(1000.0, 2000.0, "servo pulses in us, by default")
DRIVERS = {
    **dict.fromkeys(("PWM_MAIN", "PWM_AUX", "PCA9685", "HIL_ACT"), PULSE),
    **{"SIM_GZ_EC": SPEEDS, "TAP_ESC": OutputRange(1200.0, 1900.0, "speeds of TAP_ESC")},
}
"""What the outputs of PX4's drivers run over where no setting says it; another driver's range is not known."""


def beyond(values: np.ndarray, low: float, high: float) -> int:
    """Samples outside a range that move there: what clipping would flatten. Levels of rest below it are no commands."""
    slack = SLACK * (high - low)
    below = values[values < low - slack]
    resting = len(np.unique(below[:100_000])) <= REST_LEVELS
    return int((values > high + slack).sum()) + (0 if resting else len(below))


def range_of(file: object, key: str, values: np.ndarray, allowed: Sequence[OutputRange]) -> OutputRange:
    """The first of the ranges that settings allow which holds all outputs.

    Raises InputError where none does, with the range of the outputs.
    """
    finite = values[np.isfinite(values)]
    fitting = next((one for one in allowed if one.holds(finite)), None)
    if fitting is None:
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
        wrong = f"runs from {low:g} to {high:g}"
        fit = " or ".join(map(str, allowed)) or "settings of its range (PREFIX_MINn, PREFIX_MAXn)"
        expected = f"{fit}, or a map (--map) with scale and offset of each motor"
        raise InputError(str(file), key, wrong, expected)
    return fitting


def of_px4(settings: Mapping[str, float], prefix: str, number: int, raw: Sequence[np.ndarray]) -> list[OutputRange]:
    """Ranges that PX4's settings allow for output `number` (from 1) of a group (`PWM_MAIN`, `UAVCAN_EC`, ...).

    `raw` are the outputs of all motors (T,): fractions are commands, for no protocol of pulses or counts has them.
    """
    finite = [values[np.isfinite(values)] for values in raw]
    parts = np.concatenate(finite) if finite else np.empty(0)
    if len(parts) and float(np.abs(parts).max()) <= 1.0 and bool((parts % 1.0 != 0.0).any()):
        return [UNIT]
    if prefix == "UAVCAN_EC":
        low, high = settings.get(f"UAVCAN_EC_MIN{number}", 1.0), settings.get(f"UAVCAN_EC_MAX{number}", 8191.0)
        return [OutputRange(low, high, "UAVCAN_EC_MIN, UAVCAN_EC_MAX")]
    allowed = []
    if settings.get("UAVCAN_ENABLE", 0.0) >= 3:
        allowed.append(OutputRange(UAVCAN.low, UAVCAN.high, "UAVCAN, by UAVCAN_ENABLE"))
    timers = [int(value) for key, value in settings.items() if key.startswith(f"{prefix}_TIM")]
    mixed = any(timer >= -1 for timer in timers) and any(timer < -1 for timer in timers)
    if settings.get("DSHOT_CONFIG", 0.0) > 0 or any(-5 <= timer <= -2 for timer in timers):
        name = "DSHOT_CONFIG" if settings.get("DSHOT_CONFIG", 0.0) > 0 else f"{prefix}_TIM"
        allowed.append(OutputRange(DSHOT.low, DSHOT.high, f"DShot, by {name}"))
    pulses = _px4_pulses(settings, prefix, number)
    if pulses is None:
        return allowed
    if -1 in timers or settings.get("PWM_RATE") == 0.0:
        allowed.append(OutputRange(pulses.low / 8.0, pulses.high / 8.0, f"OneShot125, an eighth of {pulses.about}"))
    return [pulses, *allowed] if mixed or _rest_as_pulses(raw, pulses) else [*allowed, pulses]


def _rest_as_pulses(raw: Sequence[np.ndarray], pulses: OutputRange) -> bool:
    """Whether all motors stand together on the least value, where pulses rest: counts rest far below."""
    together = np.stack([values[: min(map(len, raw))] for values in raw]) if raw else np.empty((0, 0))
    finite = together[np.isfinite(together)]
    least = float(finite.min()) if len(finite) else 0.0
    return LEAST_PULSE <= least <= pulses.low and float((together == least).all(axis=0).mean()) > STRAY


def _px4_pulses(settings: Mapping[str, float], prefix: str, number: int) -> OutputRange | None:
    """Range by the settings of the output, of its group or of all, else the driver's; None where nothing tells it.

    A setting of -1 stands for what the group says.
    """
    ends, used = [], []
    usual = DRIVERS.get(prefix)
    for end, default in (("MIN", usual.low if usual else np.nan), ("MAX", usual.high if usual else np.nan)):
        keys = [f"{prefix}_{end}{number}", f"{prefix}_{end}", f"{prefix}_RPM_{end}"]
        keys += [f"PWM_{end}"] if usual is PULSE and prefix != "PWM_AUX" else []
        key = next((key for key in keys if settings.get(key, -1.0) >= 0.0), "")
        ends.append(settings[key] if key else default)
        used += [key] if key else []
    if usual is None or not ends[0] < ends[1]:
        return OutputRange(ends[0], ends[1], ", ".join(used)) if ends[0] < ends[1] else usual
    return OutputRange(ends[0], ends[1], ", ".join(used) if used else usual.about)


def both_ways_in_ardupilot(settings: Mapping[str, float], number: int) -> str:
    """Setting by which a motor on output `number` turns both ways; empty where none does."""
    types = ("MOT_PWM_TYPE", "SERVO_BLH_OTYPE")
    if int(settings.get(types[0], 0)) == ABOUT_A_TRIM:
        return f"{types[0]} {ABOUT_A_TRIM}"
    mask, digital = int(settings.get("SERVO_BLH_3DMASK", 0)), any(settings.get(key, 0) in DIGITAL for key in types)
    return "SERVO_BLH_3DMASK" if digital and mask >> (number - 1) & 1 else ""


def of_ardupilot(settings: Mapping[str, float], number: int) -> list[OutputRange]:
    """Ranges that ArduPilot's settings allow for output `number`; digital protocols are logged as pulses."""
    kind = int(settings.get("MOT_PWM_TYPE", 0))
    if kind == OF_THE_SERVO:
        low, high = settings.get(f"SERVO{number}_MIN", PULSE.low), settings.get(f"SERVO{number}_MAX", PULSE.high)
        return [OutputRange(low, high, f"SERVO{number}_MIN, SERVO{number}_MAX")] if low < high else [PULSE]
    if kind in DIGITAL:
        return [OutputRange(PULSE.low, PULSE.high, f"DShot logged as pulses, by MOT_PWM_TYPE {kind}")]
    throttle = f"RC{int(settings.get('RCMAP_THROTTLE', 3))}"
    for low, high in (("MOT_PWM_MIN", "MOT_PWM_MAX"), (f"{throttle}_MIN", f"{throttle}_MAX")):
        if 0.0 < settings.get(high, 0.0) and 0.0 <= settings.get(low, -1.0) < settings[high]:
            pulses = OutputRange(settings[low], settings[high], f"{low}, {high}")
            break
    else:
        pulses = PULSE
    eighth = OutputRange(pulses.low / 8.0, pulses.high / 8.0, f"OneShot125, an eighth of {pulses.about}")
    return [pulses, eighth] if kind == 2 else [pulses]
