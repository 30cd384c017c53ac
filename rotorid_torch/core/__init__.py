"""Pure torch and floats: names, parameters, states, rigid body, time loop; knows no file, no data set, no effect."""
