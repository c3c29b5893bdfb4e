"""A Flower app: a small net learns handwritten digits."""
