"""From disk to disk: rates, stages and limits."""
