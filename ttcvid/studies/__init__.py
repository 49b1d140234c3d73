"""Studies of finished results: what a run is worth beside a truth. Data frames in, numbers out; no files."""
