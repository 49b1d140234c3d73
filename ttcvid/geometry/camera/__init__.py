"""The camera: pixels to rays and back, through the lens."""
