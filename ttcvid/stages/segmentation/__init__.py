"""Which tracks belong to which body: the static scene, movers, and what stands in our way."""
