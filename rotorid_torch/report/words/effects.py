"""What each effect means to whoever flies the vehicle: as a sentence, as a noun, and what to do about it."""

from dataclasses import dataclass, field
from functools import cache

from rotorid_torch.effects.families.sensors import DAMPED, PERIOD, SMOOTHED, UNITS
from rotorid_torch.effects.registry import registered


@dataclass(frozen=True)
class Words:
    """An effect in words.

    sentence : says it; `{}` stands for the sizes with units, and goes with the blank before it where none was fitted.
    noun : the same as a thing, for lists. then : what to do. sizes : words of a parameter by its name, "" for all
    others; one whose words are empty stands in tables alone. In these words `{}` stands for the value, `{UNIT}` for the
    value with its unit said so ("1": a bare number, "%": a share), `{1/}` or `{1/UNIT}` for one over it, `{late|early}`
    for its size and the word of its sign, `{name}` for the parameter's name.
    """

    sentence: str
    noun: str
    then: str
    sizes: dict[str, str] = field(default_factory=dict)


_EACH = {"common": "{}"}
_FILTER = {
    "": "time constant {}",
    PERIOD: "natural frequency {1/rad/s}",
    DAMPED: "damping {} of critical",
    SMOOTHED: "a symmetric window of variance {}",
}
_RECORDS = "Correct the records with these values, or let every later run of close-loop do so."
_DECLARE = "Weigh and measure the vehicle as flown, and declare that in dataset.toml."

EFFECTS = {
    "control.delay": Words(
        "The controls reach the rotor later than recorded: {}.",
        "a delay in the control path",
        "Look for the delay between the recorded controls and the actuators: filters, buses, time stamps. Step a"
        " control on the ground and record the actuator. Where nobody can take the delay out, model the delay.",
        _EACH,
    ),
    "control.lag": Words(
        "The controls follow their commands with a first-order lag that is not in the declared model: {}.",
        "a lag of the actuators",
        "Record the actuators' positions beside the commands, and use those as controls.",
        _EACH,
    ),
    "control.rate_limit": Words(
        "The actuators move no faster than a limit: {}.",
        "a rate limit of the actuators",
        "Fly smaller or slower inputs, below the limit, or record the actuators' positions.",
        {"inverse": "{1/}", "common": "{1/}", "": "{name} {1/}"},
    ),
    "control.backlash": Words(
        "There is play between the recorded controls and the rotor: {}.",
        "play in the control linkage",
        "Check the linkages for play on the ground, and measure the controls behind them.",
        {"width": "{}"},
    ),
    "control.slip": Words(
        "A control slips in flight: from one moment on the control stands elsewhere than recorded, {}.",
        "a control that slips in flight",
        "Inspect linkages, servo arms and trims before the next flight.",
    ),
    "rotor.inflow": Words(
        "The air through the rotor takes time to follow: {}.",
        "dynamic inflow",
        "",
        {
            "tau": "time constant {}",
            "tau_cyclic": "of its tilt {}",
            "Z": "{%} of the thrust is lost to that",
            **dict.fromkeys(("N", "a0", "along", "across"), ""),
        },
    ),
    "rotor.flap_second_order": Words(
        "Flapping shows its own oscillation.",
        "flapping of second order",
        "",
        {"share": "{%} of it", "tau": "time constant {}", "coupling": "coupling {}"},
    ),
    "rotor.lead_lag": Words(
        "The blades' lead-lag shakes the body after each step.",
        "lead-lag of the blades",
        "",
        {
            "regressing": "slow mode {}",
            "advancing": "fast mode {}",
            "damping": "both damped by {}",
            "phase": "turned by {}",
        },
    ),
    "rotor.wake_distortion": Words(
        "The wake bends as the disc turns, and makes the response off the axis: {}.",
        "wake distortion",
        "Keep the wake's distortion in the model where responses off the axis matter.",
        {"K_R": "curvature {1}", "tau": "time constant {}"},
    ),
    "rotor.speed": Words(
        "The rotor's speed gives way and the governor brings it back: {}.",
        "rotor speed",
        "",
        {
            "load": "",
            "governor": "stiffness of the governor {}",
            "rate": "damping of the governor {}",
            "Z": "thrust {m/s² per rad/s}",
            "N": "",
        },
    ),
    "rotor.stall": Words(
        "The retreating blade stalls: {}.",
        "stall of the retreating blade",
        "Use the model below that blade loading, and do not extrapolate beyond.",
        {"loss": "it loses {%} of the lift", "limit": "above a blade loading of {1}"},
    ),
    "forces.drag": Words(
        "The fuselage has drag that grows with the square of the speed: {}.",
        "drag of the fuselage",
        "Fly at several speeds to tell drag from the speed derivatives.",
        {"": "{m/s² per (m/s)²} along {name}"},
    ),
    "forces.quadratic_damping": Words(
        "Rotation is damped by the square of the rate: {}.",
        "damping by the square of the rate",
        "Fly large and small rotations, so that both parts of the damping are told apart.",
        {"L": "roll {rad/s² per (rad/s)²}", "M": "pitch {rad/s² per (rad/s)²}", "N": "yaw {rad/s² per (rad/s)²}"},
    ),
    "forces.translational_lift": Words(
        "Speed brings lift: {}.",
        "translational lift",
        "",
        {
            "Z": "thrust {m/s² per m/s} of the rotor's induced velocity",
            "N": "yaw {rad/s² per m/s}",
            "hover": "induced velocity {} in hover",
        },
    ),
    "forces.tail_interference": Words(
        "The main rotor's wake meets the tail: {}.",
        "the rotor's wake on the tail",
        "Fly through that speed slowly, with and without sideslip.",
        {"M": "pitch {}", "N": "yaw {}", "speed": "at {}", "width": "over {}"},
    ),
    "environment.ground": Words(
        "The ground is near enough to change the thrust: {}.",
        "ground effect",
        "Record the height, and fly the same manoeuvre at half a rotor diameter and well above two.",
        {
            "strength": "{%} of what theory says",
            "ground": "the ground at a height of {}",
            "radius": "as rotors of {} radius",
            "offset": "",
        },
    ),
    "environment.wind": Words(
        "A steady wind blew: {}.",
        "steady wind",
        "Fly the same manoeuvre on several headings, or record airspeed.",
        {"north": "{} to the north", "east": "{} to the east"},
    ),
    "environment.turbulence": Words(
        "Gusts shook the vehicle: {}.",
        "gusts",
        "Fly in calm air where you can. Judge the model with the gusts fed in, for no model foresees them.",
        {"intensity": "{} rms", "length": "scale {}"},
    ),
    "environment.vibration": Words(
        "The sensors record vibration at multiples of the rotor speed: {}.",
        "vibration",
        "Mount the sensors softly, or filter below the rotor speed before recording at a lower rate.",
        {"rates": "{} in the rates", "accelerations": "{} in the accelerations"},
    ),
    "mass.payload": Words(
        "The mass is not as declared: {}.", "mass other than declared", _DECLARE, {"extra": "{more|less}"}
    ),
    "mass.cg": Words(
        "The centre of gravity is not where the declaration says: {}.",
        "centre of gravity elsewhere than declared",
        _DECLARE,
        {"": "{} along {name}"},
    ),
    "mass.inertia": Words(
        "The inertia is not as declared: {}.", "inertia other than declared", _DECLARE, {"": "{name} {more|less}"}
    ),
    "mass.slung_load": Words(
        "A load swings on a cable below the vehicle: {}.",
        "a load on a cable",
        "Declare load and cable where they belong to the vehicle; else fly once without, for the bare aircraft.",
        {
            "ratio": "its mass is {} of the vehicle's",
            "length": "the cable {} long",
            "hook": "the hook {} below the centre of gravity",
            "damping": "damping {}",
        },
    ),
    "sensors.bias": Words("A sensor reads a constant too much: {}.", "a bias of a sensor", _RECORDS),
    "sensors.scale": Words("A sensor has the wrong scale: {}.", "a wrong scale of a sensor", _RECORDS),
    "sensors.misalignment": Words(
        "The IMU is turned against the body axes: {}.", "a turned IMU", _RECORDS, {"": "{} about {name}"}
    ),
    "sensors.lever_arm": Words(
        "The IMU is not where the declaration says: {}.",
        "an IMU elsewhere than declared",
        "Measure where the IMU is, from the centre of gravity, and declare the place (vehicle.imu).",
        {"": "{} along {name}"},
    ),
    "sensors.delay": Words(
        "Sensors of one unit keep another time than the others: {}.",
        "a delay of a sensor",
        f"Look at how the unit's data are stamped. {_RECORDS}",
        {"": "{name} {late|early}"},
    ),
    "sensors.filter": Words(
        "Sensors of one unit stand behind a filter: {}.",
        "a filter of a sensor",
        f"Widen the unit's filter, or record before the filter. {_RECORDS}",
        {f"{unit}{ending}": f"{unit}, {words}" for unit in UNITS for ending, words in _FILTER.items()},
    ),
    "propulsion.motor_lag": Words(
        "The motors follow their commands late: {}.",
        "a lag of the motors",
        "Keep the motors' lag in the model: a controller that is designed without the lag oscillates. Rotor speeds in"
        " the log tell more.",
        {"tau": "time constant {}"},
    ),
    "propulsion.voltage": Words(
        "Thrust falls with the battery's voltage: {}.",
        "battery voltage",
        "Record the voltage, and divide commands by the voltage in the mixer.",
        {"exponent": "as the voltage to the power {1}", "fast": "{%} of changes within a second act"},
    ),
    "propulsion.rotor_inertia": Words(
        "Rotors that speed up turn the body about the yaw axis: {}.",
        "angular momentum of the rotors",
        "Keep the rotors' angular momentum in the model where yaw matters: the fast part of the response to a yaw"
        " command comes from there.",
        {"N": ""},
    ),
    "propulsion.rotor_drag": Words(
        "The rotors have drag in their own plane: {}.",
        "drag of the rotors",
        "Keep the rotors' drag in the model for fast flight; a controller may feed the drag forward.",
        {
            "xy": "{m/s² per m/s}",
            "x": "{m/s² per m/s} forward",
            "y": "{m/s² per m/s} sideward",
            "hubs": "",
            "profile": "",
        },
    ),
    "propulsion.axial_inflow": Words(
        "Thrust changes with the flow through the rotors, as the vehicle climbs, sinks or moves through the air: {}.",
        "thrust by flow through the rotors",
        "Keep the thrust by flow through the rotors in the model for climbs, descents, fast flight and wind.",
        {"z": "{m/s² per m/s} of climb", "hubs": "", "hover": "induced velocity {} in hover", "pitch": ""},
    ),
    "propulsion.flapping": Words(
        "Speed turns the body, for the blades of the rotors flap back: {}.",
        "moments of flapping blades",
        "Keep the moments of flapping blades in the model for fast flight.",
        {"k": "{rad/s² per m/s}", "aside": "to the side {%} as much as back"},
    ),
    "propulsion.unequal": Words(
        "One rotor gives less than the others: {}.",
        "a rotor that gives less",
        "Inspect that propeller, motor and speed controller before the next flight.",
        {"": "{name} lacks {%} of its thrust"},
    ),
    "neural.forces": Words(
        "A small network describes what no named effect explains.",
        "a network",
        "Do not extrapolate: the network is held to the range of the flights that taught the network.",
    ),
}
"""Words of the library's effects by their ids."""


@cache
def words_of(effect: str) -> Words:
    """Words of an effect; of one that somebody has added, its description."""
    if effect in EFFECTS:
        return EFFECTS[effect]
    described = registered().get(effect)
    first = (described.__doc__ or "").strip().partition("\n")[0].partition(":")[0].rstrip(".") if described else ""
    noun = first[:1].lower() + first[1:] if first else effect
    return Words(f"{first or effect} acts on this vehicle: {{}}.", noun, "")
