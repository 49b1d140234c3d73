"""Camera, horizon and mask files."""
