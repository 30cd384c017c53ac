"""The parts of a helicopter, one file each, and what an altered helicopter has besides.

`section` (lift and drag at any angle of attack), `rotor` and `inflow` (blade elements on hinges, dynamic wake), `tail`
and `airframe`, then what only an altered aircraft has: `control_path`, `slung_load`, `atmosphere`, `sensor_errors`.
`aircraft` puts them together and says which row of the state is what; `hidden` alters it by each effect.
"""
