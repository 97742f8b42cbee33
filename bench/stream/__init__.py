"""The stream: rates, sizes, training, endurance."""
