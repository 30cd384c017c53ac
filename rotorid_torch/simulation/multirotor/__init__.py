"""Multirotors that fly: a rotor of blade elements each, drives, battery, air, controller and sensors.

Read `craft` (what a vehicle is) and `vehicles` (the one built in and those drawn at random), then `rotor` (blade
elements and inflow), `drive` (motors and battery), `surroundings` (ground, wind, gusts), `control` (the flight
controller), `manoeuvres` (what it is asked for), `flight` (the time loop), `channels` (sensors and declaration) and
`hidden` (effects that a vehicle can hide).
"""
