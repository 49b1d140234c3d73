"""The horizon of a camera, at rest and driving, and planar motion beside it."""
