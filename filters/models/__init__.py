"""What the filters assume: states and their layout, motion, sensors, noise, sigma-point rules, parameters."""
