"""What anybody's model may ask for beyond the package's own.

`steps`: samples taken in shorter steps where the model is too fast for one; `whole_flights`: how a model that was
fitted over segments flies whole flights; `feedback`: whether controls follow what the model does not explain; `starts`:
what initial states that are believed would change.
"""
