"""Pure mathematics of flow, epipoles, rotations and collision times: arrays in, arrays out."""
