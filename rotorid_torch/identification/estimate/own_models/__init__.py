"""What anybody's model may ask for beyond the package's own.

`steps`: samples taken in shorter steps where the model is too fast for one; `remarks`: how a model that was fitted over
segments flies whole flights, whether controls follow what it does not explain, what believed initial states would do.
"""
