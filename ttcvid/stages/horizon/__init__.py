"""The horizon of a camera, resting and driving, and planar motion with it."""
