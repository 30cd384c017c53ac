"""Pure torch and floats: names, parameters, states, rigid body, the time loop. Knows no file, no data set, no effect."""
